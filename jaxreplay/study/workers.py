"""Dask workers that run the shards of a study, on this machine or on others."""

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
from jaxreplay.study.run import RunEach

TIMEOUT = 10  # s in which a scheduler must answer
# Options of glibc's mallopt. Dask sets a low trim threshold: freed memory returns to the system and
# is requested again at the next step, a third of a step's time. With one arena per thread, glibc
# keeps 0.3 GB more.
_MALLOC = {"M_TRIM_THRESHOLD": (-1, 2**25), "M_MMAP_THRESHOLD": (-3, 2**25), "M_ARENA_MAX": (-8, 2)}


@contextmanager
def local_workers(n: int) -> Iterator[RunEach]:
    """Open n worker processes on this machine, each with one thread, on Linux pinned to a core.

    A process on its own core steps the filter faster than a thread that shares a process.
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
        client.register_plugin(WorkerSetup())
        client.register_plugin(_PinnedWorker())
        yield partial(_run_each, client)


@contextmanager
def workers_of(scheduler: str) -> Iterator[RunEach]:
    """Connect to the workers of a running Dask scheduler, such as `"tcp://10.0.0.1:8786"`.

    Raises:
        OSError: no scheduler answers there, it has no workers, or a worker cannot be set up.
    """
    try:
        client = Client(scheduler, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        raise OSError(f"no Dask scheduler at {scheduler}: {error}") from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise OSError(f"the Dask scheduler at {scheduler} has no workers; start one")
        try:
            client.register_plugin(WorkerSetup())
        except Exception as error:  # Dask passes on any kind
            raise OSError(
                f"a worker of {scheduler} cannot be set up: {error}; is jaxreplay installed there?"
            ) from None
        yield partial(_run_each, client)


def _run_each(
    client: Client, function: Callable, shared: Any, calls: dict[int, tuple]
) -> Iterator[tuple[int, Any]]:
    """Call a function once for each of `calls` on the workers; yield keys and results as they come.

    What the calls share is sent once, as a task that is done again if its worker is lost.
    """
    sent = client.submit(_same, shared, pure=False)
    futures = {
        client.submit(function, sent, *given, pure=False): key for key, given in calls.items()
    }
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    except (CancelledError, KilledWorker) as error:
        raise OSError(
            f"workers were lost: {error}; finished shards are kept; run the same command again "
            "to continue"
        ) from None


def _same(shared: Any) -> Any:
    return shared


class WorkerSetup(WorkerPlugin):
    """Prepares a worker for its first shard: cache of compiled programs, profiler, memory."""

    def setup(self, worker: Worker) -> None:
        """Set up one worker."""
        keep_compiled()
        # Dask samples a worker's stack 100 times a second and keeps an hour of it: 0.5 GB.
        for name in ("profile", "profile-cycle"):
            if name in worker.periodic_callbacks:
                # Popped as well as stopped, because Dask may start them after this setup.
                worker.periodic_callbacks.pop(name).stop()
        with suppress(AttributeError, OSError, TypeError):  # another C library
            for option, value in _MALLOC.values():
                ctypes.CDLL(None).mallopt(option, value)


class _PinnedWorker(WorkerPlugin):
    """Pins a local worker to a core, and leaves Ctrl-C to the process that started it."""

    def setup(self, worker: Worker) -> None:
        """Set up one worker."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if hasattr(os, "sched_setaffinity"):
            mine = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(0, {mine[(os.getppid() + worker.name) % len(mine)]})
