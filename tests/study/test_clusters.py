"""Workers and schedulers that go, do not answer, or are asked by strangers."""

import asyncio
import os
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager
from functools import partial

import dask.config
import psutil
import pytest
from distributed import Client, LocalCluster, Security
from distributed.comm import connect
from study_helpers import write

from jaxreplay import cli
from jaxreplay.study import workers
from jaxreplay.study.workers import local_workers, workers_of


def slow(shared, seconds):
    time.sleep(seconds)
    return shared


async def knock(address, security):
    """Connect to a port as Dask does."""
    arguments = security.get_connection_args("client")
    comm = await asyncio.wait_for(connect(address, timeout=0.5, **arguments), 1)
    await comm.close()


@contextmanager
def a_worker(cluster):
    """A worker in a process of its own, which nobody starts again."""
    command = "from distributed.cli.dask_worker import main; main()"
    arguments = [cluster.scheduler_address, "--no-nanny", "--no-dashboard", "--nthreads", "2"]
    worker = subprocess.Popen(
        [sys.executable, "-c", command, *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},  # for `slow`
        stderr=subprocess.DEVNULL,
    )
    try:
        with Client(cluster) as client:
            client.wait_for_workers(1, timeout=60)
        yield worker
    finally:
        worker.kill()
        worker.wait()


def ports():
    """The ports at which this process and its children listen."""
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    listening = (c for p in processes for c in p.net_connections() if c.status == "LISTEN")
    return {c.laddr.port: c.laddr.ip for c in listening}


def test_a_stranger_at_a_port_is_refused():
    """Neither without certificates, nor with those of another session; no page tells anything."""
    before = ports()
    with local_workers(1) as run_each:
        assert dict(run_each(slow, "mine", {7: (0,)})) == {7: "mine"}
        opened = {port: ip for port, ip in ports().items() if port not in before}
        assert set(opened.values()) == {"127.0.0.1"}
        assert len(opened) >= 3  # of the scheduler, a worker, and its nanny
        for port in opened:
            for scheme, security in (("tcp", Security()), ("tls", Security.temporary())):
                with pytest.raises((OSError, TimeoutError)):
                    asyncio.run(knock(f"{scheme}://127.0.0.1:{port}", security))
            for page in ("", "status", "health", "json/counts.json"):
                with pytest.raises(OSError):  # noqa: PT011 - 404, or no answer
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/{page}", timeout=0.5)
    with dask.config.set(workers._NO_PAGES), LocalCluster(n_workers=0) as plain:
        asyncio.run(knock(plain.scheduler_address, Security()))  # where nobody asks who it is


def test_missing_workers_are_told_and_given_up(monkeypatch):
    """After a time that the caller chooses."""
    monkeypatch.setattr(workers, "_LOOK", 0.2)
    monkeypatch.setattr(workers, "_AGAIN", 0.5)
    with (
        LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as cluster,
        a_worker(cluster) as worker,
        workers_of(cluster.scheduler_address, patience=2) as run_each,
    ):
        results = run_each(slow, "mine", {0: (0,), 1: (60,)})
        assert next(results) == (0, "mine")
        worker.kill()
        with (
            pytest.warns(UserWarning, match="no worker is left; waiting . s for one") as told,
            pytest.raises(OSError, match="no worker was left for 2 s; finished shards are kept"),
        ):
            next(results)
    assert len(told) >= 2


def test_a_scheduler_that_is_lost_is_reported(monkeypatch):
    with dask.config.set({"distributed.comm.timeouts.connect": "1s"}):
        cluster = LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0")
        try:
            with workers_of(cluster.scheduler_address) as run_each:
                results = run_each(slow, "mine", {0: (0,), 1: (60,)})
                assert next(results) == (0, "mine")
                cluster.close()
                with pytest.raises(OSError, match=r"were lost.*; finished shards are kept"):
                    next(results)
        finally:
            cluster.close()


def test_workers_that_cannot_start_are_reported():
    broken = {"distributed.nanny.preload": ["no_such_module_anywhere"]}
    with (
        dask.config.set(broken),
        pytest.raises(OSError, match="1 workers cannot be started: "),
        local_workers(1),
    ):
        pass


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--scheduler", ""], "must be an address, such as tcp://10.0.0.1:8786; got ''"),
        (["--scheduler", "somewhere"], "must be an address"),
        (["--scheduler", "tls://127.0.0.1:1"], "no Dask scheduler at tls://127.0.0.1:1: "),
        (["--scheduler", "odd://127.0.0.1:1"], "no Dask scheduler at odd://127.0.0.1:1: "),
        (["--tls-ca", "ca.pem"], "are for a --scheduler"),
        (["--scheduler", "tls://h:1", "--tls-ca", "pyproject.toml"], "--tls-cert is missing"),
        (
            ["--scheduler", "tls://h:1", *["--tls-ca", "a", "--tls-cert", "b", "--tls-key", "c"]],
            "--tls-ca a: there is no such file",
        ),
        (["--patience", "-1"], "must be 0 s or more"),
    ],
)
def test_a_mistake_about_a_scheduler_is_one_line(tmp_path, capsys, monkeypatch, given, message):
    monkeypatch.setattr(workers, "TIMEOUT", 0.5)
    config = write(tmp_path, "theta_i = 0.1")
    run = partial(cli.main, ["run", str(config), "--out", str(tmp_path / "out"), *given])
    try:
        status = run()
    except SystemExit as stop:  # argparse
        status = stop.code
    assert status == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert message in last
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_certificates_are_used(tmp_path):
    """With those of the scheduler its workers are reached."""
    security = Security.temporary()
    files = []
    for name, content in (
        ("ca", security.tls_ca_file),
        ("cert", security.tls_client_cert),
        ("key", security.tls_client_key),
    ):
        files.append(tmp_path / name)
        files[-1].write_text(content)
    with (
        LocalCluster(
            n_workers=1, threads_per_worker=1, security=security, dashboard_address="127.0.0.1:0"
        ) as cluster,
        workers_of(cluster.scheduler_address, workers.Certificates(*files)) as run_each,
    ):
        assert cluster.scheduler_address.startswith("tls://")
        assert dict(run_each(slow, "mine", {3: (0,)})) == {3: "mine"}
