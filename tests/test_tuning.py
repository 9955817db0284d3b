import dataclasses
import tomllib

import jax
import matplotlib.image
import numpy as np
import pytest
from conftest import random_sequences
from filter_helpers import COMPILE_QUICKLY, both_readings

from jaxreplay import Params, Records, cli, reference, tuning

LENGTHS = (60, 52, 44)  # one shape for all, so that JAX compiles once
SIGMA = np.array([0.5, 2.0])
GRID = Params(  # five sets of parameters wherever scores are taken, for the same reason
    [0.125, 0.5, 0.0625, 0.25, 0.75],
    [0.0625, 0.25, 0.125, 0.5, 0.0],
    np.array([1, 2, 0.5, 4, 1])[:, None] * SIGMA,
)


@pytest.fixture(scope="module", autouse=True)
def quickly():
    """The gradient compiled so: it takes longer to compile than all else takes to run."""
    compiled = jax.jit(
        tuning._gradient.__wrapped__,
        static_argnames="jump",
        compiler_options=COMPILE_QUICKLY,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "_gradient", compiled)
        yield


@pytest.fixture(scope="module")
def sequences():
    """Three walks that begin alike, so that one may be followed by means of the others.

    The last of three commands never changes.
    """
    sensors, commands = random_sequences(3, LENGTHS, step=0.25)
    common = np.cumsum(np.ones((max(LENGTHS), 2)), axis=0) / 8
    sensors = [s + common[: len(s)] for s in sensors]
    return sensors, [np.column_stack([c, np.full(len(c), 7)]) for c in commands]


@pytest.fixture(scope="module")
def records(sequences):
    return Records.from_sequences(*sequences)


def expected(sequences, i, theta_i, theta_tau, sigma, jump):
    """Log evidence of record i, and its squared command errors `[T, 2]`, by the reference."""
    span = np.ptp(np.concatenate(sequences[1]), axis=0)
    sensors, commands = ([x for k, x in enumerate(part) if k != i] for part in sequences)
    belief, total, squares = reference.initial(sensors), 0.0, []
    for z, v in zip(sequences[0][i], sequences[1][i], strict=True):
        belief = reference.predict(sensors, theta_i, theta_tau, belief, jump)
        squares.append(((reference.command(commands, belief) - v)[:2] / span[:2]) ** 2)
        belief, gained = reference.update(sensors, sigma, belief, z)
        total += gained
    return total, np.array(squares)


@both_readings
def test_scores_are_the_references(sequences, records, jump):
    scores = tuning.leave_one_out(records, GRID, jump)
    assert scores.steps.tolist() == list(LENGTHS)
    for p in range(5):
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


@pytest.mark.parametrize(("n", "i"), [(1, 0), (3, 3), (3, -1)])
def test_what_cannot_be_left_out_is_refused(records, n, i):
    with pytest.raises(ValueError, match="cannot be left out" if n == 1 else "no record"):
        tuning.leave_out(records.subset(range(n)), i)


@pytest.mark.parametrize(
    ("jump", "score"),
    [
        pytest.param("same_tau", "commands", marks=pytest.mark.slow),
        ("own_tau", "commands"),
        ("own_tau", "evidence"),
    ],
)
def test_the_gradient_is_that_of_differences_of_the_reference(sequences, records, jump, score):
    """In logit θ_I, logit 2 θ_τ and log σ; of a record that is shorter than the arrays."""
    free, i = tuning._free(Params(0.125, 0.0625, SIGMA)), 1
    part, row = tuning.leave_out(records, i), tuning._rows(records)[i]
    scale = tuning._command_scale(records)
    weights = np.array([score == name for name in tuning.SCORES], float)
    ours = tuning._gradient(free, part, row, scale, weights, jump)
    at = np.concatenate([np.ravel(x) for x in free]).astype(float)

    def loss(x):
        theta_i, theta_tau = 1 / (1 + np.exp(-x[:2]))
        evidence, squares = expected(sequences, i, theta_i, theta_tau / 2, np.exp(x[2:]), jump)
        return squares.mean(axis=1).sum() if score == "commands" else -evidence

    eye, h = np.eye(4), 1e-4
    want = [(loss(at + h * e) - loss(at - h * e)) / (2 * h) for e in eye]
    np.testing.assert_allclose(np.concatenate([np.ravel(x) for x in ours]), want, rtol=1e-3)


@pytest.fixture(scope="module")
def paced():
    """The same way at three paces, seen with noise: neither time nor what is seen tells enough.

    The second sensor sees nothing but noise.
    """
    rng = np.random.default_rng(0)
    ways = [np.linspace(0, 6, n) for n in LENGTHS]
    sensors = [np.column_stack([w, 0 * w]) + 0.3 * rng.normal(size=(len(w), 2)) for w in ways]
    commands = [np.column_stack([np.sin(w), np.cos(w), 0 * w + 7]) for w in ways]
    return Records.from_sequences(sensors, commands)


def test_the_climb_comes_to_the_best_of_a_grid(paced):
    """Of the two σ; within a tenth of what there is to gain."""
    *_, end = tuning.climb(paced, tuning.usual(paced), "own_tau", steps=40)
    across = np.geomspace(0.04, 4, 5)

    def errors(sigmas):
        thetas = [np.full(5, theta) for theta in (end.theta_i, end.theta_tau)]
        return tuning.leave_one_out(paced, Params(*thetas, sigmas), "own_tau").command_error

    best = min(errors(np.column_stack([np.full(5, a), across])).min() for a in across)
    before, *_, after = errors(np.geomspace(tuning.usual(paced).sigma, end.sigma, 5))
    assert best < 0.8 * before
    assert after - best < 0.1 * (before - best)


def test_evidence_drives_the_sigma_of_what_repeats_itself_to_the_least(paced, monkeypatch):
    monkeypatch.setattr(tuning, "SHARES", (0.05, 10.0))
    sensors, commands = paced.sequences()
    sensors = [np.column_stack([s[:, 0], np.arange(len(s)) % 2]) for s in sensors]
    repeating = Records.from_sequences(sensors, commands)
    *_, end = tuning.climb(repeating, tuning.usual(repeating), "own_tau", "evidence", steps=30)
    assert end.sigma[1] == pytest.approx(0.05, rel=1e-5)


@pytest.mark.parametrize("score", tuning.SCORES)
def test_tune_prints_and_saves(tmp_path, records, capsys, score):
    path = tmp_path / "walks.npz"
    records.save(path)
    given = ["--jump", "own_tau", "--steps", "4", "--score", score]
    assert cli.main(["tune", str(path), *given]) == 0
    printed = capsys.readouterr().out
    saved = tomllib.loads((tmp_path / "walks_own_tau.toml").read_text(encoding="utf-8"))
    assert list(saved) == ["theta_i", "theta_tau", "sigma"]
    assert list(saved["sigma"]) == ["z0", "z1"]
    assert matplotlib.image.imread(tmp_path / "walks_own_tau.png").std() > 0

    usual = tuning.usual(records)
    held = Params(saved["theta_i"], saved["theta_tau"], list(saved["sigma"].values()))
    five = jax.tree.map(lambda *x: np.stack(x), usual, held, held, held, held)
    scores = jax.tree.map(lambda x: x[:2], tuning.leave_one_out(records, five, "own_tau"))
    if score == "commands":
        assert scores.command_error[1] < scores.command_error[0]
    else:
        assert scores.log_evidence[1] > scores.log_evidence[0]
    for name, want in (
        ("log evidence", scores.log_evidence),
        ("command error", 100 * scores.command_error),
    ):
        row = next(line for line in printed.splitlines() if line.startswith(name))
        assert [float(x) for x in row.split()[2:4]] == pytest.approx(want, rel=1e-3)


@pytest.mark.parametrize(
    ("held", "arguments", "message"),
    [
        (1, [], "one.npz: one record cannot be left out: there is only 1; at least 2 are needed"),
        (2, [], "one.npz: no command ever changes in the records: there is none to predict"),
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
        still = dataclasses.replace(records, commands=0 * records.commands)
        (still if held == 2 else records).subset(range(held)).save(path)
    assert cli.main(["tune", str(path), *arguments]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
