"""Processes that run the shards of a study: Dask's, here or on other machines."""

import logging
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from typing import Any

import dask
from distributed import Client, KilledWorker, LocalCluster, Worker, WorkerPlugin, as_completed

from jaxreplay.machine import keep_compiled

PATIENCE = 10  # seconds, for a scheduler to answer
# glibc gives memory back that the next step asks for again, and Dask asks it to do so at once: a
# third of a step's time went into that.
_KEEP_MEMORY = {"MALLOC_TRIM_THRESHOLD_": 2**30, "MALLOC_MMAP_THRESHOLD_": 2**30}

RunEach = Callable[[Callable, Any, dict[int, tuple]], Iterator[tuple[int, Any]]]


@contextmanager
def local_workers(n: int) -> Iterator[RunEach]:
    """N processes on this machine, one thread each, one core each where that can be told.

    On its own core a process steps the filter faster than a thread does that shares a process
    with others.
    """
    with (
        dask.config.set({"distributed.nanny.pre-spawn-environ": _KEEP_MEMORY}),
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
        yield partial(_run_each, client)


@contextmanager
def workers_of(scheduler: str) -> Iterator[RunEach]:
    """The workers of a running Dask scheduler, such as `"tcp://10.0.0.1:8786"`.

    Raises:
        OSError: no scheduler answers there, or it has no workers.
    """
    try:
        client = Client(scheduler, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise OSError(f"no Dask scheduler at {scheduler}: {error}") from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise OSError(f"the Dask scheduler at {scheduler} has no workers; start one")
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
    """Before JAX starts in a worker."""

    def setup(self, worker: Worker):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asked
        keep_compiled()
        if hasattr(os, "sched_setaffinity"):
            mine = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(0, {mine[(os.getppid() + worker.name) % len(mine)]})
