"""Processes that run the shards of a study: Dask's, here or on other machines."""

import ctypes
import logging
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from distributed import Client, KilledWorker, LocalCluster, Worker, WorkerPlugin, as_completed

from jaxreplay.machine import keep_compiled

PATIENCE = 10  # seconds, for a scheduler to answer
# For glibc's mallopt. Dask has it give memory back at once that the next step asks for again, which
# is a third of a step's time; and each of a run's threads keeps an arena, some 0.3 GB in all.
_MALLOC = {"M_TRIM_THRESHOLD": (-1, 2**25), "M_MMAP_THRESHOLD": (-3, 2**25), "M_ARENA_MAX": (-8, 2)}

RunEach = Callable[[Callable, Any, dict[int, tuple]], Iterator[tuple[int, Any]]]


@contextmanager
def local_workers(n: int) -> Iterator[RunEach]:
    """N processes on this machine, one thread each, one core each where that can be told.

    On its own core a process steps the filter faster than a thread does that shares a process
    with others.
    """
    with (
        LocalCluster(
            n_workers=n,
            threads_per_worker=1,
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(_Settled())
        client.register_plugin(_Pinned())
        yield partial(_run_each, client)


@contextmanager
def workers_of(scheduler: str) -> Iterator[RunEach]:
    """The workers of a running Dask scheduler, such as `"tcp://10.0.0.1:8786"`.

    Raises:
        OSError: no scheduler answers there, it has no workers, or one cannot be set up.
    """
    try:
        client = Client(scheduler, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise OSError(f"no Dask scheduler at {scheduler}: {error}") from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise OSError(f"the Dask scheduler at {scheduler} has no workers; start one")
        try:
            client.register_plugin(_Settled())
        except Exception as error:  # of whatever kind a worker's is told as
            raise OSError(
                f"a worker of {scheduler} cannot be set up: {error}; is jaxreplay installed there?"
            ) from None
        yield partial(_run_each, client)


def _run_each(client: Client, function: Callable, shared: Any, calls: dict[int, tuple]):
    """Call a function with what is shared and each of the others; keys and results, as they come.

    What is shared is sent once, as a task that is done again should its worker be lost.
    """
    held = client.submit(_same, shared, pure=False)
    futures = {
        client.submit(function, held, *given, pure=False): key for key, given in calls.items()
    }
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    except (CancelledError, KilledWorker) as error:
        raise OSError(
            f"workers were lost: {error}; finished shards are kept, the same command goes on"
        ) from None


def _same(shared: Any) -> Any:
    return shared


class _Settled(WorkerPlugin):
    """What is done in every worker before its first shard."""

    def setup(self, worker: Worker):
        keep_compiled()
        # Dask samples a worker's stack 100 times a second and keeps that for an hour: 0.5 GB.
        for name in ("profile", "profile-cycle"):
            if name in worker.periodic_callbacks:  # taken out, as they may not be started yet
                worker.periodic_callbacks.pop(name).stop()
        with suppress(AttributeError, OSError, TypeError):  # another C library
            for option, value in _MALLOC.values():
                ctypes.CDLL(None).mallopt(option, value)


class _Pinned(WorkerPlugin):
    """A worker of this machine's own: a core to itself, and Ctrl-C is for who asked for it."""

    def setup(self, worker: Worker):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if hasattr(os, "sched_setaffinity"):
            mine = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(0, {mine[(os.getppid() + worker.name) % len(mine)]})
