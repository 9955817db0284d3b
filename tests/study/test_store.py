import os
import resource
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray as xr
from study_helpers import VARIABLES, of_beginnings

from jaxreplay import cli, open_study
from jaxreplay.errors import ConfigError
from jaxreplay.study import run, runs, shard
from jaxreplay.study.config import load_config
from jaxreplay.study.store import locked, read_manifest, read_shard, write_shard

pytestmark = pytest.mark.usefixtures("fewer_windows")

TEXT = """
seed = 4
repeats = 1
slots = 2
theta_i = 0.01
[axis]
jump = ["own_tau"]
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A config, and a folder with its 5 runs in 3 shards."""
    config = of_beginnings(tmp_path_factory.mktemp("config"), TEXT)
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "SLOTS", 2)
        patch.setattr(shard, "audit", lambda *replay: (0.0, 0.0))  # takes long, tested elsewhere
        run.run_study(load_config(config), folder)
        yield config, folder


def copy_of(folder, to):
    """The folder's files, elsewhere."""
    for path in folder.rglob("*"):
        if path.is_file():
            (to / path.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
            (to / path.relative_to(folder)).write_bytes(path.read_bytes())
    return to


def shards(folder):
    return {path.name: path.read_bytes() for path in sorted((folder / "shards").glob("*.nc"))}


def counted(monkeypatch):
    """How many runs each shard that is computed has."""
    computed, run_shard = [], run.run_shard

    def counting(*args):
        computed.append(len(args[3]))
        return run_shard(*args)

    monkeypatch.setattr(run, "run_shard", counting)
    return computed


def test_only_what_is_missing_is_run_and_comes_to_the_same_bytes(finished, tmp_path, monkeypatch):
    config, folder = finished
    again, computed = copy_of(folder, tmp_path), counted(monkeypatch)
    (again / "shards" / "00002.nc").unlink()
    dataset = open_study(again)
    assert (dataset.outcome == "").sum() == 1
    assert np.isnan(dataset.log_evidence).sum() == 1
    run.run_study(load_config(config), again)
    assert computed == [1]
    assert shards(again) == shards(folder)
    xr.testing.assert_identical(open_study(again), open_study(folder))


def flipped(content, at, bit=0):
    """The bytes with one bit changed."""
    return content[:at] + bytes([content[at] ^ (1 << bit)]) + content[at + 1 :]


@pytest.mark.parametrize(
    "damage",
    ["cut", "emptied", "garbage", "of another study", "of another kind", "of another shard", "bit"],
)
def test_a_shard_that_is_damaged_or_foreign_is_set_aside_and_run_again(
    finished, tmp_path, monkeypatch, damage
):
    config, folder = finished
    again, computed = copy_of(folder, tmp_path), counted(monkeypatch)
    path = again / "shards" / "00001.nc"
    whole = path.read_bytes()
    spoilt = {
        "cut": whole[:-100],
        "emptied": b"",
        "garbage": b"CDF\x01 not much",
        "of another study": whole.replace(read_manifest(again)["hash"].encode(), 64 * b"0"),
        "of another kind": whole.replace(b"duration", b"gradient"),
        "of another shard": (again / "shards" / "00000.nc").read_bytes(),
        "bit": flipped(whole, whole.rindex(b"\x40")),  # of a float's exponent
    }[damage]
    path.write_bytes(spoilt)
    with pytest.warns(UserWarning, match=r"00001\.nc is .*; left out: jaxreplay run does its runs"):
        assert (open_study(again).outcome == "").sum() == 2
    with pytest.warns(UserWarning, match=r"00001\.nc is damaged, or not of this study; kept as"):
        run.run_study(load_config(config), again)
    assert computed == [2]
    assert shards(again) == shards(folder)
    assert (again / "shards" / "00001.nc.bad").read_bytes() == spoilt


def test_a_truncated_manifest_is_set_aside(finished, tmp_path, monkeypatch):
    config, folder = finished
    again, computed = copy_of(folder, tmp_path), counted(monkeypatch)
    (again / "study.json").write_text((folder / "study.json").read_text()[:-40])
    with pytest.raises(ValueError, match="is not the manifest of a study"):
        open_study(again)
    with pytest.warns(UserWarning, match=r"study\.json is not the manifest .*; kept as"):
        run.run_study(load_config(config), again)
    assert computed == []
    assert read_manifest(again) == read_manifest(folder)


def test_a_folder_of_another_study_is_refused_and_left_alone(finished, tmp_path):
    _, folder = finished
    again = copy_of(folder, tmp_path / "out")
    other = of_beginnings(tmp_path, TEXT.replace("repeats = 1", "repeats = 2\nsigma = 0.2"))
    before = {path: path.read_bytes() for path in again.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match=r"differs in .*config\.fixed\.sigma, config\.repeats; "):
        run.run_study(load_config(other), again)
    assert before == {path: path.read_bytes() for path in again.rglob("*") if path.is_file()}


def test_two_at_once_in_a_folder_are_reported(finished, tmp_path, capsys):
    config, folder = finished
    again = copy_of(folder, tmp_path)
    with locked(again):
        assert cli.main(["run", str(config), "--out", str(again)]) == 2
    assert "another process is running this study" in capsys.readouterr().err
    assert cli.main(["run", str(config), "--out", str(again)]) == 0


def test_an_interrupt_keeps_what_was_finished(finished, tmp_path, monkeypatch):
    config, folder = finished
    again = copy_of(folder, tmp_path)
    for name in ("00001.nc", "00002.nc"):
        (again / "shards" / name).unlink()
    run_shard = run.run_shard
    with monkeypatch.context() as patch:

        def interrupted(config, records, some, which, progress):
            if len(which) == 1:
                raise KeyboardInterrupt
            return run_shard(config, records, some, which, progress)

        patch.setattr(run, "run_shard", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run.run_study(load_config(config), again)
    assert set(shards(again)) == {"00000.nc", "00001.nc"}
    assert cli.main(["run", str(config), "--out", str(again)]) == 0
    assert shards(again) == shards(folder)


def test_a_full_disk_is_reported_and_leaves_no_half_file(finished, tmp_path, monkeypatch, capsys):
    """A limit on the size of files stands for the disk."""
    config, folder = finished
    again = copy_of(folder, tmp_path)
    manifest = read_manifest(again)
    dataset = read_shard(again, 1, manifest, VARIABLES, 2)
    (again / "shards" / "00001.nc").unlink()
    monkeypatch.setattr(run, "run_shard", lambda *args: dataset)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
        assert cli.main(["run", str(config), "--out", str(again)]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "File too large" in capsys.readouterr().err
    assert set(shards(again)) == {"00000.nc", "00002.nc"}
    assert not list(again.rglob("*.part"))
    write_shard(again, 1, manifest, dataset)
    assert shards(again) == shards(folder)


@pytest.mark.slow
@pytest.mark.parametrize("more", [[], ["--workers", "2"]])
def test_killed_at_50_moments_it_goes_on_to_the_same_bytes(tmp_path, more):
    """25 kills each way, spread over a run's time; whatever is finished stays as it is."""
    config = of_beginnings(tmp_path, TEXT.replace("repeats = 1\nslots = 2", "repeats = 34"))
    cache = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache")}
    cache["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

    def started(out):
        command = [sys.executable, "-m", "jaxreplay", "run", str(config), "--out", str(out), *more]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return subprocess.Popen(command, env=os.environ | cache, **quiet)

    for _ in range(2):  # the first compiles
        begin, rehearsal = time.monotonic(), tmp_path / "rehearsal"
        shutil.rmtree(rehearsal, ignore_errors=True)
        assert started(rehearsal).wait() == 0
    lasts, whole, out = time.monotonic() - begin, shards(rehearsal), tmp_path / "out"
    rng, killed = np.random.default_rng(50), 0
    while killed < 25:
        process = started(out)
        try:
            process.wait(rng.uniform(0, lasts))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            killed += 1
        process.wait()
        found = shards(out) if (out / "shards").exists() else {}
        assert found == {name: whole[name] for name in found}
        if len(found) == len(whole):
            (out / "shards" / rng.choice(sorted(whole))).unlink()
    assert started(out).wait() == 0
    assert shards(out) == whole
    xr.testing.assert_identical(open_study(out), open_study(rehearsal))


def test_of_several_processes_started_at_once_one_works(tmp_path):
    """The others say so; none spoils the demonstrations."""
    (tmp_path / "study.toml").write_text("theta_i = 0.1\n")
    command = [sys.executable, "-m", "jaxreplay", "run", "study.toml"]
    each = [
        subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) for _ in range(3)
    ]
    deadline = time.monotonic() + 60
    while sum(process.poll() is None for process in each) > 1 and time.monotonic() < deadline:
        time.sleep(0.1)
    working = [process for process in each if process.poll() is None]
    for process in working:
        process.terminate()
    told = [process.communicate()[1] for process in each]
    assert sorted(process.returncode for process in each) == [2, 2, 143]
    assert len(working) == 1
    assert sum("another process is running this study" in text for text in told) == 2
