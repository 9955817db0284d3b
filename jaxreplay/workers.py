"""Processes that run the shards of a study: Dask's, here or on other machines."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import dask
from distributed import Client, LocalCluster, Worker, WorkerPlugin

from jaxreplay.machine import keep_compiled

PATIENCE = 10  # seconds, for a scheduler to answer
# glibc gives memory back that the next step asks for again, and Dask asks it to do so at once: a
# third of a step's time went into that.
_KEEP_MEMORY = {"MALLOC_TRIM_THRESHOLD_": 2**30, "MALLOC_MMAP_THRESHOLD_": 2**30}


@contextmanager
def local_workers(n: int) -> Iterator[Client]:
    """N processes on this machine, one thread each, one core each where that can be told.

    On its own core a process steps the filter faster than a thread does that shares a process
    with others.
    """
    with (
        dask.config.set({"distributed.nanny.pre-spawn-environ": _KEEP_MEMORY}),
        LocalCluster(n, threads_per_worker=1, dashboard_address=None, memory_limit=0) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(_Settled())
        yield client


@contextmanager
def workers_of(scheduler: str) -> Iterator[Client]:
    """The workers of a running Dask scheduler, such as `"tcp://10.0.0.1:8786"`.

    Raises:
        OSError: no scheduler answers there.
    """
    try:
        client = Client(scheduler, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise OSError(f"no Dask scheduler at {scheduler}: {error}") from None
    with client:
        yield client


class _Settled(WorkerPlugin):
    """Before JAX starts in a worker."""

    def setup(self, worker: Worker):
        keep_compiled()
        if hasattr(os, "sched_setaffinity"):
            mine = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(0, {mine[worker.name % len(mine)]})
