import os
import signal
import subprocess
import sys
import time
from functools import partial

import pytest
import xarray as xr
from distributed import Client, LocalCluster

from jaxreplay import cli, open_study
from jaxreplay.study import run, runs, workers
from jaxreplay.study.config import load_config
from jaxreplay.study.workers import local_workers

TEXT = """
seed = 4
repeats = 1
slots = 2
theta_i = 0.01
jump = "own_tau"
[axis]
motor_unit = [0.002]
"""


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(TEXT)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 3])
def test_workers_come_to_the_same_bytes_though_one_is_killed(config, tmp_path, monkeypatch, n):
    monkeypatch.setattr(runs, "SLOTS", 2)
    alone, killed = run.run_study(load_config(config), tmp_path / "alone"), []

    def kill_a_busy_one(outcome, duration):
        if not (outcome != "").any():
            return  # nobody is at work yet
        client = Client.current()
        busy = [worker for worker, tasks in client.processing().items() if tasks]
        if busy and not killed:
            pids = client.run(os.getpid)
            assert len(pids) == n
            killed.append(pids[busy[0]])
            os.kill(killed[0], signal.SIGKILL)

    together = run.run_study(
        load_config(config), tmp_path / "together", kill_a_busy_one, partial(local_workers, n)
    )
    assert killed
    xr.testing.assert_identical(together, alone)
    for path in (tmp_path / "alone" / "shards").iterdir():
        assert path.read_bytes() == (tmp_path / "together" / "shards" / path.name).read_bytes()
    assert (open_study(tmp_path / "together").outcome != "").all()


def test_a_worker_keeps_no_profile():
    with local_workers(1) as run_each:
        client = run_each.args[0]
        client.submit(time.sleep, 1).result()
        samples = client.run(profile_of)
    assert list(samples.values()) == [0]


def profile_of(dask_worker):
    """How often its stack was sampled: it would be 100 times a second."""
    history = [profile for _, profile in dask_worker.profile_history]
    return sum(profile["count"] for profile in [*history, dask_worker.profile_recent])


def test_a_scheduler_that_does_not_answer_is_reported(config, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(workers, "TIMEOUT", 0.1)
    out = tmp_path / "out"
    given = ["run", str(config), "--out", str(out), "--scheduler", "tcp://127.0.0.1:1"]
    assert cli.main(given) == 2
    assert not out.exists()  # reported before any work is done
    error = capsys.readouterr().err
    assert "no Dask scheduler at tcp://127.0.0.1:1" in error
    assert "Traceback" not in error


def test_a_worker_without_jaxreplay_is_reported(config, tmp_path, capsys):
    bare = (
        "import sys; sys.modules['jaxreplay'] = None; "
        "from distributed.cli.dask_worker import main; main()"
    )
    with LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as cluster:
        address = cluster.scheduler_address
        worker = subprocess.Popen(
            [sys.executable, "-c", bare, address, "--no-nanny", "--no-dashboard"],
            stderr=subprocess.DEVNULL,
        )
        try:
            with Client(cluster) as client:
                client.wait_for_workers(1, timeout=60)
            given = ["run", str(config), "--out", str(tmp_path / "out"), "--scheduler", address]
            assert cli.main(given) == 2
        finally:
            worker.kill()
            worker.wait()
    error = capsys.readouterr().err
    assert f"a worker of {address} cannot be set up" in error
    assert "is jaxreplay installed there?" in error
    assert "Traceback" not in error


@pytest.mark.parametrize("given", [["--workers", "0"], ["--workers", "2", "--scheduler", "x"]])
def test_workers_that_make_no_sense_are_refused(config, given):
    with pytest.raises(SystemExit) as stop:
        cli.main(["run", str(config), *given])
    assert stop.value.code == 2
