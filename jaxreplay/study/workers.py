"""Dask workers that run the shards of a study, on this machine or on others."""

import ctypes
import logging
import os
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import dask.config
from distributed import Client, KilledWorker, LocalCluster, Security, Worker, WorkerPlugin

from jaxreplay.machine import keep_compiled
from jaxreplay.study.run import RunEach

TIMEOUT = 10  # s in which a scheduler must answer
# Options of glibc's mallopt. Dask sets a low trim threshold: freed memory returns to the system and
# is requested again at the next step, a third of a step's time. With one arena per thread, glibc
# keeps 0.3 GB more.
_MALLOC = {"M_TRIM_THRESHOLD": (-1, 2**25), "M_MMAP_THRESHOLD": (-3, 2**25), "M_ARENA_MAX": (-8, 2)}


PATIENCE = 60.0  # s without any worker, by default
_POLL = 0.05  # s between looks whether a shard is finished
_LOOK = 3.0  # s between looks whether there are workers, while no shard is
_AGAIN = 10.0  # s between two lines on missing workers
_KEPT = "finished shards are kept; run the same command again to continue"
# Without these, a process offers pages on its state to whoever asks.
_NO_PAGES = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}


@contextmanager
def local_workers(n: int, patience: float = PATIENCE) -> Iterator[RunEach]:
    """Open n worker processes on this machine, each with one thread, on Linux pinned to a core.

    A process on its own core steps the filter faster than a thread that shares a process. They talk
    over TLS with certificates of this session: a plain port would let every user of the machine
    run code in them.

    Args:
        n: number of workers.
        patience: s without any worker after which the study is given up.

    Raises:
        OSError: they cannot be started.
    """
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_NO_PAGES))
        try:
            cluster = LocalCluster(
                n_workers=n,
                threads_per_worker=1,
                memory_limit=0,
                security=Security.temporary(),
                dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
            )
            client = Client(stack.enter_context(cluster), set_as_default=False)
            stack.callback(client.close, 2)
            client.register_plugin(WorkerSetup())
            client.register_plugin(_PinnedWorker())
        except Exception as error:  # Dask passes on any kind
            raise OSError(f"{n} workers cannot be started: {_cause(error)}") from None
        yield partial(_run_each, client, patience)


class Certificates(NamedTuple):
    """Files for a scheduler that is reached over TLS.

    Attributes:
        ca: certificate of the authority that signed the scheduler's.
        cert: certificate of this client.
        key: its private key.
    """

    ca: Path
    cert: Path
    key: Path


@contextmanager
def workers_of(
    scheduler: str, certificates: Certificates | None = None, patience: float = PATIENCE
) -> Iterator[RunEach]:
    """Connect to the workers of a running Dask scheduler, such as `"tcp://10.0.0.1:8786"`.

    Args:
        scheduler: its address.
        certificates: for an address that begins with `tls://`; None: those of Dask's own
            configuration.
        patience: s without any worker after which the study is given up.

    Raises:
        OSError: no scheduler answers there, it has no workers, or a worker cannot be set up.
    """
    security = None
    if certificates is not None:
        ca, cert, key = map(str, certificates)
        security = Security(
            tls_ca_file=ca, tls_client_cert=cert, tls_client_key=key, require_encryption=True
        )
    with ExitStack() as stack:
        try:
            client = Client(scheduler, timeout=TIMEOUT, security=security, set_as_default=False)
            stack.callback(client.close, 2)
        except Exception as error:  # of addresses, certificates, connections
            raise OSError(f"no Dask scheduler at {scheduler}: {_cause(error)}") from None
        if not _workers_left(client):
            raise OSError(f"the Dask scheduler at {scheduler} has no workers; start one")
        try:
            client.register_plugin(WorkerSetup())
        except Exception as error:  # Dask passes on any kind
            raise OSError(
                f"a worker of {scheduler} cannot be set up: {_cause(error)}; is jaxreplay "
                "installed there?"
            ) from None
        yield partial(_run_each, client, patience)


def _run_each(
    client: Client, patience: float, function: Callable, shared: Any, calls: dict[int, tuple]
) -> Iterator[tuple[int, Any]]:
    """Call a function once for each of `calls` on the workers; yield keys and results as they come.

    What the calls share is sent once, as a task that is done again if its worker is lost.

    Raises:
        OSError: workers or the scheduler were lost.
    """
    sent = client.submit(_same, shared, pure=False)
    futures = {
        client.submit(function, sent, *given, pure=False): key for key, given in calls.items()
    }
    waiting, looked, none_since, told = set(futures), time.monotonic(), None, 0.0
    try:
        while waiting:
            done = {future for future in waiting if future.done()}
            for future in done:
                yield futures[future], future.result()
            waiting -= done
            now = time.monotonic()
            if done or now - looked < _LOOK:
                time.sleep(_POLL)
                continue
            looked = now
            if client.status in ("closing", "closed"):
                raise OSError(f"the scheduler was lost; {_KEPT}")
            if _workers_left(client):
                none_since, told = None, 0.0
                continue
            none_since = none_since or now
            if now - none_since > patience:
                raise OSError(f"no worker was left for {patience:g} s; {_KEPT}")
            if now - told > _AGAIN:
                told = now
                left = max(patience - (now - none_since), 0)
                warnings.warn(f"no worker is left; waiting {left:.0f} s for one", stacklevel=2)
    except (CancelledError, KilledWorker) as error:
        raise OSError(f"workers or the scheduler were lost: {_cause(error)}; {_KEPT}") from None


def _workers_left(client: Client) -> int:
    """Return how many workers there are; 0 where the scheduler does not answer."""
    try:
        scheduler: Any = client.scheduler
        answer: Any = client.sync(scheduler.identity, callback_timeout=TIMEOUT)
        return len(answer["workers"])
    except (OSError, TimeoutError, AttributeError):  # the last: the client has closed
        return 0


def _cause(error: BaseException) -> str:
    """Return what went wrong, in one line."""
    while error.__cause__ is not None and not str(error).strip():
        error = error.__cause__
    return " ".join(f"{error}".split())[:300] or type(error).__name__


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
