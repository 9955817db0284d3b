"""That the scripts in experiments/ run, at a size that says nothing."""

import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import xarray as xr

from jaxreplay import tracker

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))

import findings
import loop
import pieces


@pytest.mark.parametrize("laps", [(1,), (8,), (2, 5)])
@pytest.mark.parametrize("lamp", [False, True])
def test_what_is_shown_is_laps_and_the_way_to_the_goal(laps, lamp):
    records = loop.demonstrate(loop.Shown(laps, lamp=lamp), np.random.default_rng(1))
    sensors, commands = records.sequences()
    for seen, sent, k in zip(sensors, commands, np.resize(laps, loop.N), strict=True):
        place = seen[:, 0] + 1j * seen[:, 1]
        left = np.argmax(np.abs(place) > 1.3 * loop.RADIUS)
        assert np.abs(place[left:] - loop.GOAL)[20:].max() < loop.ARRIVED
        assert np.abs(np.abs(place[:left]) - loop.RADIUS).max() < 0.3 * loop.RADIUS
        driven = np.unwrap(np.angle(place[: left + 1])) / (2 * np.pi)
        assert driven[-1] - driven[0] == pytest.approx(k, abs=0.15)
        assert np.abs(sent).max() < 1.5 * loop.SPEED
        lit = np.flatnonzero(seen[:, 2])
        assert len(lit) == lamp * (loop.LONGEST - lit.min(initial=loop.LONGEST))
        if lamp:
            assert left - lit[0] == pytest.approx(loop.LAP / 2, abs=6)


def test_a_robot_is_held_or_carried_along_the_circle_once():
    env = loop.Circle(2)
    told = loop.options(2, noise=0, held=[7, 0], carried=[0, 0.25], wanted=9, lamp=False)
    env.reset(seed=[1, 2], options=told | {"reset_mask": np.ones(2, bool)})
    angles = []
    for _ in range(4 * loop.LAP):
        around = 1j * loop.SPEED * np.exp(1j * env.angle)
        env.step(np.stack([around.real, around.imag], axis=1))
        angles.append(env.angle.copy())
    steps = np.diff(angles, axis=0)
    usual = steps[0]
    np.testing.assert_array_equal(np.sum(np.abs(steps) < 1e-12, axis=0), [7, 0])
    leaps = steps > 3 * usual
    np.testing.assert_array_equal(leaps.sum(axis=0), [0, 1])
    assert steps[leaps] == pytest.approx(np.pi / 2, abs=2 * usual[1])
    held = np.flatnonzero(steps[:, 0] == 0)
    assert angles[held[0]][0] == pytest.approx(3 * np.pi, abs=2 * usual[0])


@pytest.mark.slow
def test_the_laps_experiment_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tracker, "WINDOWS", ())  # to compile less
    monkeypatch.setattr(loop, "STEPS", 60)  # enough for one lap
    monkeypatch.setattr(loop, "CONDITIONS", {})
    monkeypatch.setattr(loop, "WANTED", (1, 4))
    monkeypatch.setattr(loop, "THETA_I", loop.FEW)
    monkeypatch.setattr(sys, "argv", ["loop.py", "--repeats", "1", "--out", str(tmp_path / "new")])
    loop.main()
    table = capsys.readouterr().out
    for row in ("8 laps, shown in step", "1 and 4 laps shown, told 4"):
        assert table.count(f"\n{row}") == 2  # once for each reading
    assert "1 (21–100)" in table  # Wilson's interval of 1 of 1
    assert matplotlib.image.imread(tmp_path / "new" / "loop.png").shape[2] == 4
    assert (tmp_path / "new" / "loop.pdf").read_bytes().startswith(b"%PDF")


def test_no_repeats_at_all_is_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["loop.py", "--repeats", "0"])
    with pytest.raises(SystemExit, match="2"):
        loop.main()
    assert "--repeats must be at least 1" in capsys.readouterr().err


def test_a_piece_follows_one_record_for_a_second_at_least():
    record = np.repeat([3, 5, 3, 0, 3, 7], [20, 4, 10, 30, 16, 20])
    found = pieces.pieces_of(record)
    np.testing.assert_allclose(found, [[3, 0, 0.2], [0, 0.34, 0.64], [3, 0.64, 0.8], [7, 0.8, 1]])
    np.testing.assert_allclose(pieces.switches_of(found), [0.34, 0.64, 0.8])
    assert len(pieces.pieces_of(np.arange(9))) == 0


def test_findings_are_of_the_runs_they_name():
    dims = ("theta_i", "position")
    outcome = np.array([["S", "Fs"], ["S", "S"], ["Fg", "S"]])
    error = np.array([[1.0, 9.0], [2.0, 4.0], [9.0, 5.0]])
    runs = xr.Dataset(
        {"outcome": (dims, outcome), "alignment_error": (dims, error)},
        {"theta_i": [0.1, 0.01, 0.001]},
    )
    assert findings.within(0.005, 1)(runs) == "S 75 (30–95) %; by θ_I 50, 100"
    assert findings.mean(runs, "alignment_error").startswith("3.0 (")
    told = findings.mean_by_theta_i("alignment_error", "mm")(runs)
    assert told.endswith("mm; by θ_I from 1.0 to 5.0")
