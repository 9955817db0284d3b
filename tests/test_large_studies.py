"""The large studies, what is found in them, and the intervals over sets of demonstrations."""

import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import xarray as xr

from jaxreplay import Params, Records
from jaxreplay.study.config import load_config

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))

import findings
import sensors
import sets

FOLDER = Path(sets.__file__).parent


def sets_of(outcome, **more):
    """Runs of three sets of demonstrations, `[3, θ_I, position]`."""
    dims = ("seed", "theta_i", "position")
    runs = xr.Dataset({"outcome": (dims, np.array(outcome))}, {"theta_i": [0.1, 0.01]})
    runs.theta_i.attrs["symbol"] = "θ_I"
    return runs.assign({name: (dims, np.array(values)) for name, values in more.items()})


S, F = "S", "Fg"


def test_intervals_are_over_sets_of_demonstrations():
    runs = sets_of([[[S, F], [S, S]], [[F, F], [S, F]], [[S, F], [S, S]]])
    first, second = runs.isel(theta_i=0), runs.isel(theta_i=1)
    half = 4.303 * np.std([0.5, 0.0, 0.5], ddof=1) / np.sqrt(3)  # Student's t, two degrees
    assert sets.success(first) == pytest.approx((1 / 3, 1 / 3 - half, 1 / 3 + half), abs=1e-3)
    assert sets.percent(sets.success(first)) == "33 (0–100)"
    assert sets.points(sets.gain(second, first)) == "+50 (+50, +50)"
    assert sets.percent(sets.success(second.isel(seed=[0, 2]))) == "100 (51–100)"  # Wilson's
    errors = np.where(runs.outcome == S, [[[3.0], [5.0]], [[9.0], [4.0]], [[5.0], [9.0]]], 99.0)
    runs = runs.assign(error=(runs.outcome.dims, errors))
    assert sets.number(sets.average(runs.isel(theta_i=0), "error")) == "4.0 (-8.7–16.7)"
    assert sets.number(sets.average(runs.isel(theta_i=0, seed=[1]), "error")) == "–"


def test_success_is_drawn_for_each_set_and_reading(tmp_path):
    runs = sets_of([[[S, F], [S, S]], [[F, F], [S, F]], [[S, F], [S, S]]])
    study = xr.concat([runs, runs], xr.Variable("jump", ["same_tau", "own_tau"]))
    sets.figure(study, tmp_path / "sets.png")
    assert matplotlib.image.imread(tmp_path / "sets.png").std() > 0


def test_controllers_are_drawn_against_the_number_of_demonstrations(tmp_path):
    shape = 3, 2, 3, 4
    outcome = np.broadcast_to(np.array([S, S, F, S]), shape)
    dims = ("seed", "controller", "records", "position")
    names = {"controller": ["filter", "tape"], "records": ["2 drawn", "4 drawn", "20 drawn"]}
    runs = xr.Dataset({"outcome": (dims, outcome)}, {"jump": "own_tau", **names})
    sets.figure(runs, tmp_path / "few.png")
    assert matplotlib.image.imread(tmp_path / "few.png").std() > 0
    repeats = sets.pooled(runs.expand_dims("repeat"))
    assert repeats.outcome.sizes == {"repeat": 3, "controller": 2, "records": 3, "position": 4}


def test_findings_compare_runs_of_the_same_set():
    outcome = [[[S, F], [S, S]], [[F, F], [S, F]], [[S, F], [S, S]]]
    runs = sets_of(outcome, stall=np.full((3, 2, 2), "", "<U6"))
    rows = list(findings.by(first="theta_i")(runs))
    assert [row.name for row in rows] == ["θ_I 0.1", "θ_I 0.01"]
    assert findings.rates(rows[0]) == "S 33 (0–100) %, by set 0–50"
    assert findings.rates(rows[1]) == "S 83 (12–100) %, by set 50–100, difference +50 (+50, +50)"
    assert findings.p_value(rows[0], rows[0]) == 1
    runs.stall.values[1, 0] = "fixed", "cyclic"
    whole = findings.Row("all", runs)
    share = sets.percent(sets.interval(np.array([0, 2 / 3, 0])))
    assert findings.stalls(whole) == (
        f"{share} % of 5 failures are stalls: fixed 1, cyclic 1, slow 0, Fb 0, Fg 5"
    )


def test_a_sensor_that_tells_two_records_apart_gives_one_bit_once():
    rows = [np.tile([level, 0.0], (50, 1)) for level in (0.0, 9.0)]
    records = Records.from_sequences(rows, [np.zeros((50, 1))] * 2)
    seen = np.tile([9.0, 0.0], (20, 1))
    bits = sensors.information(records, Params(0.0, 0.05, np.ones(2)), "own_tau", seen)
    assert bits.shape == (20, 4)  # the last: all but the first, and all
    np.testing.assert_allclose(bits[0], [1, 0, 0, 1], atol=1e-4)
    np.testing.assert_allclose(bits[1:], 0, atol=1e-4)
    parts = sensors.in_parts(np.arange(60.0)[:, None])
    np.testing.assert_allclose(parts[0], np.arange(1.0, 60, 3))


def test_the_large_sizes_are_listed_in_one_file(tmp_path):
    fake = tmp_path / ".venv" / "bin" / "jaxreplay"
    fake.parent.mkdir(parents=True)
    fake.write_text('#!/bin/sh\nprintf "%s\\n" "$*"\n')
    fake.chmod(0o755)
    (tmp_path / "experiments").mkdir()
    script = shutil.copy(FOLDER / "large.sh", tmp_path / "experiments")
    printed = subprocess.run(["sh", script, "--workers", "2"], capture_output=True, text=True)
    runs = Counter()
    for line in printed.stdout.splitlines():
        run, file, _, out, *others = line.split()
        assert run == "run"
        assert others[-2:] == ["--workers", "2"]
        config = load_config(FOLDER / Path(file).name, others[1:-2:2])
        suffix = "_same_tau" if config.fixed.get("jump") == "same_tau" else ""
        if file.endswith("rivals.toml"):
            suffix = "".join(f"_{name}" for name in ("records", "push") if name in config.axes)
        assert out == f"results/large/{Path(file).stem}{suffix}/{config.seed}"
        runs[Path(out).parent.name] += config.n_runs
    assert runs == LARGE


LARGE = {
    "theta_i": 2 * 10 * 300, "interpolation": 2 * 5 * 300, "dithering": 2 * 3 * 300,
    "battery": 3 * 300, "light": 2 * 300, "jumps": 4 * 300, "sensors": 9 * 300,
    "outside": 2 * 130 * 3, "grid": 4 * 3 * 7 * 30, "sigma": 7 * 7 * 30, "noise": 4 * 7 * 30,
    "rivals": 2 * 7 * 300, "rivals_records": 5 * 4 * 300, "rivals_push": 3 * 4 * 300,
    "interpolation_same_tau": 5 * 300, "light_same_tau": 2 * 300,
    "dithering_same_tau": 2 * 3 * 300, "battery_same_tau": 3 * 300, "grid_same_tau": 4 * 3 * 7 * 30,
}  # fmt: skip


def test_findings_distinguish_where_a_cube_stood():
    cubes = np.array([[0.3, 0.05], [0.45, 0.0], [0.2, 0.2], [0.3, -0.15]])
    runs = xr.Dataset(
        {"outcome": (("jump", "position"), [["S", "S", "Fb", "Fg"], ["S", "Fs", "S", "Fg"]])},
        {
            "jump": ["own_tau", "same_tau"],
            "cube_x": ("position", cubes[:, 0]), "cube_y": ("position", cubes[:, 1]),
        },
    )  # fmt: skip
    rows = [(row.name, sorted(row.runs.outcome.values)) for row in findings.around(runs)]
    assert rows == [
        ("own_tau, demonstrated area, 1 positions", ["S"]),
        ("own_tau, outside, in sight, 2 positions", ["Fg", "S"]),
        ("own_tau, outside, out of sight, 1 positions", ["Fb"]),
        ("same_tau, demonstrated area, 1 positions", ["S"]),
        ("same_tau, outside, in sight, 2 positions", ["Fg", "Fs"]),
        ("same_tau, outside, out of sight, 1 positions", ["S"]),
    ]
