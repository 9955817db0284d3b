import dataclasses
import tomllib

import jax
import numpy as np
import pytest
from conftest import random_sequences

from jaxreplay import Params, Records, cli, log_evidence, reference, tuning

LENGTHS = (60, 52, 44)
SIGMA = np.array([0.5, 2.0])
GRID = Params([0.125, 0.5], [0.0625, 0.25], [SIGMA, 2 * SIGMA])

both_readings = pytest.mark.parametrize("jump", ["same_tau", "own_tau"])


@pytest.fixture(scope="module")
def sequences():
    """Three walks that begin alike, so that one may be followed by means of the others."""
    sensors, commands = random_sequences(3, LENGTHS, step=0.25)
    common = np.cumsum(np.ones((max(LENGTHS), 2)), axis=0) / 8
    return [s + common[: len(s)] for s in sensors], commands


@pytest.fixture(scope="module")
def records(sequences):
    return Records.from_sequences(*sequences)


def expected(sequences, i, theta_i, theta_tau, sigma, jump):
    """Log evidence of record i, and its squared command errors `[T, n_u]`, by the reference."""
    span = np.ptp(np.concatenate(sequences[1]), axis=0)
    sensors, commands = ([x for k, x in enumerate(part) if k != i] for part in sequences)
    belief, total, squares = reference.initial(sensors), 0.0, []
    for z, v in zip(sequences[0][i], sequences[1][i], strict=True):
        belief = reference.predict(sensors, theta_i, theta_tau, belief, jump)
        squares.append(((reference.command(commands, belief) - v) / span) ** 2)
        belief, gained = reference.update(sensors, sigma, belief, z)
        total += gained
    return total, np.array(squares)


@both_readings
def test_scores_are_the_references(sequences, records, jump):
    scores = tuning.leave_one_out(records, GRID, jump)
    assert scores.steps.tolist() == list(LENGTHS)
    for p in range(2):
        values = float(GRID.theta_i[p]), float(GRID.theta_tau[p]), np.asarray(GRID.sigma[p], float)
        each = [expected(sequences, i, *values, jump) for i in range(3)]
        for i, (evidence, squares) in enumerate(each):
            assert scores.log_evidence_each[p, i] == pytest.approx(evidence / LENGTHS[i], rel=1e-4)
            error = np.sqrt(squares.mean())
            assert scores.command_error_each[p, i] == pytest.approx(error, rel=1e-4)
        evidence = sum(evidence for evidence, _ in each) / sum(LENGTHS)
        error = np.sqrt(np.concatenate([squares for _, squares in each]).mean())
        assert scores.log_evidence[p] == pytest.approx(evidence, rel=1e-4)
        assert scores.command_error[p] == pytest.approx(error, rel=1e-4)


def test_some_records_may_be_held_out(records):
    told = []
    some = tuning.leave_one_out(records, GRID, "own_tau", [2, 0], lambda *n: told.append(n))
    every = tuning.leave_one_out(records, GRID, "own_tau")
    assert some.steps.tolist() == [44, 60]
    np.testing.assert_array_equal(some.log_evidence_each, every.log_evidence_each[:, [2, 0]])
    assert max(told) == (104, 104)


def test_what_is_left_out_tells_nothing_of_itself(records):
    """What the held-out record did, first or last, does not show in what remains of the others."""
    changed = dataclasses.replace(
        records, nodes=records.nodes.at[:, 1].mul(7), commands=records.commands.at[:, 1].add(3)
    )
    for ours, theirs in zip(
        jax.tree.leaves(tuning.leave_out(records, 1)),
        jax.tree.leaves(tuning.leave_out(changed, 1)),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("i", range(3))
def test_left_out_is_the_subset_of_the_others_in_one_shape(sequences, records, i):
    part = tuning.leave_out(records, i)
    others = [k for k in range(3) if k != i]
    for ours, theirs in zip(part.sequences(), sequences, strict=True):
        for a, k in zip(ours, others, strict=True):
            np.testing.assert_allclose(a, theirs[k], rtol=1e-6)
    subset = records.subset(others)
    np.testing.assert_array_equal(part.span, subset.span)
    assert part.nodes.shape == (2, 2, max(LENGTHS) + 2)


@both_readings
def test_the_gradient_is_that_of_differences_of_the_reference(sequences, records, jump):
    """In logit θ_I, logit 2 θ_τ and log σ."""
    params = Params(0.125, 0.0625, SIGMA)
    free, seen = tuning._free(params), tuning._observations(records)
    ours = tuning._gradient(free, tuning.leave_out(records, 0), seen[0], jump)
    at = np.concatenate([np.ravel(x) for x in free]).astype(float)

    def evidence(x):
        theta_i, theta_tau = 1 / (1 + np.exp(-x[:2]))
        return expected(sequences, 0, theta_i, theta_tau / 2, np.exp(x[2:]), jump)[0]

    eye, h = np.eye(4), 1e-4
    want = [(evidence(at + h * e) - evidence(at - h * e)) / (2 * h) for e in eye]
    np.testing.assert_allclose(np.concatenate([np.ravel(x) for x in ours]), want, rtol=1e-3)


def test_the_climb_comes_to_the_best_of_a_grid():
    """Records that are each other and noise of a known σ: one sensor, no jump needed."""
    rng = np.random.default_rng(0)
    sensors = [np.linspace(0, 6, 40)[:, None] + 0.3 * rng.normal(size=(40, 1)) for _ in range(3)]
    records = Records.from_sequences(sensors, sensors)
    *_, end = tuning.climb(records, tuning.usual(records), "own_tau", steps=60)
    sigmas = np.geomspace(0.1, 1.5, 25)
    grid = Params(
        np.full(25, end.theta_i), np.full(25, end.theta_tau), sigmas[:, None].astype(np.float32)
    )
    scores = tuning.leave_one_out(records, grid, "own_tau")
    best = sigmas[np.argmax(scores.log_evidence)]
    assert np.log(end.sigma[0] / best) == pytest.approx(0, abs=0.12)  # one of the grid's steps
    at_end = jax.tree.map(lambda x: x[None], end)
    assert tuning.leave_one_out(records, at_end, "own_tau").log_evidence[0] > (
        scores.log_evidence.max() - 0.01
    )


def test_a_sensor_that_repeats_itself_stops_at_the_least_sigma(monkeypatch):
    monkeypatch.setattr(tuning, "SHARES", (0.05, 10.0))
    seen = np.column_stack([np.linspace(0, 6, 40), np.tile([0.0, 1.0], 20)])
    noise = 0.3 * np.random.default_rng(0).normal(size=(3, 40, 1)) * [1, 0]
    records = Records.from_sequences(seen + noise, seen + noise)
    *_, end = tuning.climb(records, tuning.usual(records), "own_tau", steps=40)
    assert end.sigma[1] == pytest.approx(0.05, rel=1e-5)


def test_tune_prints_and_saves(tmp_path, records, capsys):
    path = tmp_path / "walks.npz"
    records.save(path)
    assert cli.main(["tune", str(path), "--jump", "own_tau", "--steps", "4"]) == 0
    printed = capsys.readouterr().out
    saved = tomllib.loads((tmp_path / "walks_own_tau.toml").read_text(encoding="utf-8"))
    assert list(saved) == ["theta_i", "theta_tau", "sigma"]
    assert list(saved["sigma"]) == ["z0", "z1"]
    assert (tmp_path / "walks_own_tau.png").stat().st_size > 0

    usual = tuning.usual(records)
    held = Params(saved["theta_i"], saved["theta_tau"], list(saved["sigma"].values()))
    pair = jax.tree.map(lambda *x: np.stack(x), usual, held)
    before, after = tuning.leave_one_out(records, pair, "own_tau").log_evidence
    assert after > before
    row = next(line for line in printed.splitlines() if line.startswith("log evidence"))
    assert [float(x) for x in row.split()[2:4]] == pytest.approx([before, after], rel=1e-3)


@pytest.mark.parametrize(
    ("held", "arguments", "message"),
    [
        (1, [], "one.npz holds 1 record; tuning leaves one out of 2 or more"),
        (0, [], "no records file"),
        (None, [], "does not hold records"),
        (2, ["--out", "here.txt"], "here.txt: give a file whose name ends in .toml"),
    ],
)
def test_a_mistake_is_one_line(tmp_path, records, capsys, held, arguments, message):
    path = tmp_path / "one.npz"
    if held is None:
        path.write_text("no")
    elif held:
        records.subset(range(held)).save(path)
    assert cli.main(["tune", str(path), *arguments]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1


def test_derivatives_in_what_cannot_be_chosen_are_refused(records):
    seen = np.zeros((3, 2), np.float32)
    with pytest.raises(TypeError, match="in σ only"):
        jax.grad(lambda z: log_evidence(records, Params(0.1, 0.05, SIGMA), z))(seen)
