"""That the scripts in experiments/ run, at a size that proves nothing."""

import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import xarray as xr
from scipy.stats import spearmanr

from jaxreplay import Params, Records
from jaxreplay.filter.options import Options
from jaxreplay.loop import tracker
from jaxreplay.loop.rivals import controller_named
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.recordings.scores import leave_one_out
from jaxreplay.study.config import load_config
from jaxreplay.study.demonstrations import record

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))
sys.path.insert(0, str(Path(__file__).parents[1] / "experiments/benchmarks"))

import causes
import circle
import elsewhere
import in_step
import loop
import pieces
import plain_filter
import plane_step
import stalls
import starts
import tuning
from filter_helpers import both_readings, run_reference


@pytest.mark.parametrize("laps", [(1,), (8,), (2, 5)])
@pytest.mark.parametrize("lamp", [False, True])
def test_what_is_shown_is_laps_and_the_way_to_the_goal(laps, lamp):
    records = circle.demonstrate(circle.Shown(laps, lamp=lamp), np.random.default_rng(1))
    sensors, commands = records.sequences()
    for seen, sent, k in zip(sensors, commands, np.resize(laps, circle.N), strict=True):
        place = seen[:, 0] + 1j * seen[:, 1]
        left = np.argmax(np.abs(place) > 1.3 * circle.RADIUS)
        assert np.abs(place[left:] - circle.GOAL)[20:].max() < circle.ARRIVED
        assert np.abs(np.abs(place[:left]) - circle.RADIUS).max() < 0.3 * circle.RADIUS
        driven = np.unwrap(np.angle(place[: left + 1])) / (2 * np.pi)
        assert driven[-1] - driven[0] == pytest.approx(k, abs=0.15)
        assert np.abs(sent).max() < 1.5 * circle.SPEED
        lit = np.flatnonzero(seen[:, 2])
        assert len(lit) == lamp * (circle.LONGEST - lit.min(initial=circle.LONGEST))
        if lamp:
            assert left - lit[0] == pytest.approx(circle.LAP / 2, abs=6)


def test_a_robot_is_held_or_carried_along_the_circle_once():
    env = circle.Circle(2)
    given = circle.options(2, noise=0, held=[7, 0], carried=[0, 0.25], wanted=9, lamp=False)
    env.reset(seed=[1, 2], options=given | {"reset_mask": np.ones(2, bool)})
    angles = []
    for _ in range(4 * circle.LAP):
        around = 1j * circle.SPEED * np.exp(1j * env.angle)
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
    monkeypatch.setattr(circle, "STEPS", 60)  # enough for one lap
    monkeypatch.setattr(loop, "CONDITIONS", {})
    monkeypatch.setattr(loop, "WANTED", (1, 4))
    monkeypatch.setattr(loop, "THETA_I", loop.FEW)
    monkeypatch.setattr(sys, "argv", ["loop.py", "--repeats", "1", "--out", str(tmp_path / "new")])
    loop.main()
    table = capsys.readouterr().out
    for row in ("8 laps, shown in step", "1 and 4 laps shown, lamp: 4"):
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


def test_demonstrations_in_step_do_the_same_at_the_same_moment():
    records = record(PlaneParams(), DEMONSTRATED[[0, 9, 17]], seed=3)
    before, after = records.sequences()[1], in_step.in_step(records).sequences()[1]
    assert {len(sent) for sent in after} == {sorted(map(len, before))[1]}

    def changes(sent):  # when the gripper is first commanded to scan, to grasp, to hold and to lift
        moments = [np.flatnonzero(np.diff(sent[:, k]) * way > 0)[0] for k, way in GRIPPER]
        return PlaneParams().control_period * np.array(moments)

    apart = np.ptp([changes(sent) for sent in before], axis=0)
    assert apart.min() > 2  # s
    assert np.ptp([changes(sent) for sent in after], axis=0).max() < 0.5
    for was, sent in zip(before, after, strict=True):  # as far, though not at the same speed
        np.testing.assert_allclose(was[:, :2].sum(0), sent[:, :2].sum(0), rtol=0.01, atol=0.02)


def test_each_cause_is_a_study_that_can_be_run():
    for name, changes in causes.CHANGES.items():
        config = load_config(causes.STUDY, [*causes.SIZE, *changes])
        assert config.n_runs == 2 * 3 * 6, name
        assert callable(controller_named(config.fixed["controller"]))


def test_causes_are_compared_within_sets(tmp_path):
    jump, theta_i = ["same_tau", "own_tau"], [0.3, 0.01, 1e-25]

    def made_up(share):
        outcome = np.where(np.arange(10) < 10 * share, "S", "Fs")
        shape = (2, 2, 3, 10)
        return xr.Dataset(
            {"outcome": (("seed", "jump", "theta_i", "position"), np.broadcast_to(outcome, shape))},
            {"seed": [1, 2], "jump": jump, "theta_i": theta_i},
        )

    runs = {causes.FIRST: made_up(0.5), "no track bias": made_up(0.8)}
    rows = causes.table(runs).splitlines()
    assert len(rows) == 6 * 4
    assert " ".join(rows[3].split()) == "no track bias 80 (58–92) +30 (+30, +30) 4 0 0"
    causes.figure(runs, tmp_path / "causes.png")
    assert matplotlib.image.imread(tmp_path / "causes.png").std() > 0


GRIPPER = (3, 1), (3, -1), (4, 1), (2, 1)  # column of the commands, and up or down


def test_runs_that_switch_are_compared_with_the_same_runs_without_jumps(tmp_path):
    one, two = (np.array(rows) for rows in ([[3, 0, 1]], [[3, 0, 0.5], [5, 0.5, 1]]))
    found = pieces.Pieced(
        won=np.array([[True, True, False], [True, False, False]]),  # θ_I of 0.1, and 0
        pieces=[[one, two, two], [one, one, one]],
        without=[[one, one, one], [one, one, one]],
        spread=np.zeros((7, 101)),
    )
    theta_i = np.array([0.1, 0.0])
    row = pieces.table(theta_i, [found, found]).splitlines()[2].split()
    assert row[:2] == ["0.1", "67"]
    assert row[3:8:2] == ["1.7", "1.0", "1.7"]
    assert row[9:12] == ["0%,", "100%,", "0%"]
    assert row[12] == "4"
    assert row[13::2] == ["50", "0"]
    pieces.figure(theta_i, [found, found], tmp_path / "pieces.png")
    assert matplotlib.image.imread(tmp_path / "pieces.png").std() > 0


def test_scores_from_records_are_those_of_tune_and_parts_of_them(monkeypatch):
    monkeypatch.setattr(tracker, "WINDOWS", ())  # to compile less
    rng = np.random.default_rng(2)
    sensors = [np.cumsum(rng.normal(size=(n, 2)), axis=0) for n in (40, 35, 45)]
    commands = [1.0 * np.column_stack([np.arange(len(z)) >= 20, 0 * z[:, 0]]) for z in sensors]
    records = Records.from_sequences(sensors, commands)
    params = Params(np.array([0.1, 0.01]), np.full(2, 0.05), np.array([[1.0, 1.0], [2.0, 2.0]]))
    chosen = np.array([0, 2])
    whole = leave_one_out(records, params, "own_tau", chosen)
    found = tuning.scores_of(records, params, "own_tau", chosen)
    np.testing.assert_allclose(found["command error"], -100 * whole.command_error, rtol=1e-5)
    np.testing.assert_allclose(found["log evidence"], whole.log_evidence, rtol=1e-5)
    _, evidence = tuning.predicted(records, params, "own_tau", 0, sensors[0], commands[0])
    _, last = tuning.predicted(records, params, "own_tau", 2, sensors[2], commands[2])
    moving = np.concatenate([evidence[20:], last[20:]]).mean(axis=0)
    np.testing.assert_allclose(found["… while it moves"], moving, rtol=1e-5)
    assert len({tuple(score) for score in found.values()}) == 6


def test_a_start_anywhere_finds_what_is_unlike_the_rest():
    way = np.linspace(0, 1, 80)[:, None]
    sensors = [np.hstack([way, way**2]) + 0.001 * k for k in range(3)]
    records = Records.from_sequences(sensors, [way - 0.5] * 3, period=0.1)
    errors = starts.errors_of(records, 1, 3)
    assert set(errors) == set(starts.WAYS)
    assert errors["anywhere"][1] < 0.05 < 0.2 < errors["first"][0]
    assert errors["from the beginning"].max() < 0.05
    assert errors["nearest row"].max() < 0.02


@both_readings
def test_the_plain_filter_is_the_filter_until_it_underflows(jump):
    rng = np.random.default_rng(5)
    walk = rng.normal(size=(40, 2)).cumsum(axis=0)
    sensors = [walk, walk[:30] + rng.normal(size=(30, 2))]
    commands = [rng.normal(size=(n, 1)) for n in (40, 30)]
    zs = walk[:30] + 0.3 * rng.normal(size=(30, 2))
    sequences, values = (sensors, commands), (0.1, 0.05, np.array([1.0, 0.5]))
    _, wanted, evidence, ended = run_reference(sequences, zs, *values, jump)
    batch = Params(*(np.array([value]) for value in values))
    plain = plain_filter.PlainTracker(Records.from_sequences(*sequences), batch, Options(jump))
    for z, u, e, p in zip(zs, wanted, evidence, ended, strict=True):
        np.testing.assert_allclose(plain.command[0], u, atol=1e-3)
        gained, at_end, _ = plain.observe(z[None], np.array([True]))
        assert gained[0] == pytest.approx(e, abs=1e-2)
        assert at_end[0] == pytest.approx(p, abs=1e-3)
    gained, *_ = plain.observe(np.full((1, 2), 1e3), np.array([True]))
    assert gained[0] == -np.inf  # and goes on
    assert np.isfinite(plain.command).all()


def test_a_stall_is_described_by_its_last_minute():
    p = np.zeros((600, 4))
    p[:, 2], p[:, 0] = 0.9, 0.1
    p[300:400] = p[300:400, ::-1]  # record 1 leads for 10 s
    tau = np.full((600, 4), 5.0)
    tau[:, 2] += np.linspace(0, 1, 600)
    units = np.tile([0.4, -0.2], (600, 1))
    units[:150, 0] = 2.0
    stall = stalls.Stall("a run", p, tau, units)
    (values,) = stalls.features([stall])
    assert values[:4] == pytest.approx([3, 90, 2, 0.9], abs=1e-2)
    assert values[4:] == pytest.approx([(150 * 2.2 + 450 * 0.6) / 1200, 75, 0], abs=1e-2)
    other = stall._replace(units=-units)
    assert stalls.typical([stall, other, stall]) is stall


def test_bootstrap_intervals():
    rng = np.random.default_rng(1)
    score = rng.normal(size=300)
    success = np.round(score + rng.normal(size=300), 1)  # with ties
    rho, low, high = tuning.correlation(score, success)
    assert rho == pytest.approx(spearmanr(score, success).statistic)
    assert low < rho < high
    assert tuning.correlation(-score, success)[0] == pytest.approx(-rho)
    assert np.isnan(tuning.correlation(score, np.ones(300))).all()
    assert np.isfinite(tuning.correlation(score[:4], np.array([0, 0, 1, 1]))).all()


def test_a_point_retraces_a_path_and_is_pushed_once():
    times = np.linspace(1, 3, 50)
    path = np.stack([np.sin(times), times**2], axis=1)
    rows = elsewhere.resampled(times, path, dt=0.3)
    np.testing.assert_allclose(rows[[0, -1]], path[[0, -1]])
    assert len(rows) == 8  # 2 s are about 7 steps
    env = elsewhere.Point(2, dt=0.3, push_at=3, steps=7)
    given = {"start": np.tile(rows[0], (2, 1)), "push": np.array([0.0, 0.5])}
    env.reset(seed=[5, 5], options=given | {"reset_mask": np.ones(2, bool)})
    off = []
    for row, velocity in zip(rows[1:], elsewhere.velocities(rows, 0.3), strict=True):
        seen, _, terminated, truncated, _ = env.step(np.tile(velocity, (2, 1)))
        off.append(np.linalg.norm(seen - row, axis=1))
        assert not terminated.any()
    assert truncated.all()
    np.testing.assert_allclose(off, [[0, 0]] * 2 + [[0, 0.5]] * 5, atol=1e-12)


def test_the_plane_sees_what_a_plain_loop_over_pymunk_sees():
    seen = plane_step.observations()
    for expected in seen.values():
        np.testing.assert_allclose(seen["jaxreplay"], expected, atol=1e-3)
    assert (seen["jaxreplay"][:, 1:] > 0).any()
