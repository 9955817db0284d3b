import jax
import numpy as np
import pytest
from recordings_helpers import (
    SIGMA,
    TUNED_LENGTHS,
    expected,
    far_from_zero,
    gradient_compiled_quickly,
)

from jaxreplay import Params, Records, reference
from jaxreplay.recordings import optimise
from jaxreplay.recordings.scores import command_scale, default_params, leave_one_out, leave_out


@pytest.fixture(scope="module", autouse=True)
def quickly():
    with gradient_compiled_quickly():
        yield


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
    x, i = optimise._unconstrained(Params(0.125, 0.0625, SIGMA)), 1
    others, rows = leave_out(records, i).centred(), optimise._rows(records)[i]
    scale = command_scale(records)
    weights = np.array([score == name for name in optimise.SCORES], float)
    ours = optimise._gradient(x, others, rows, scale, weights, jump)
    at = np.concatenate([np.ravel(part) for part in x]).astype(float)

    def loss(x):
        theta_i, theta_tau = 1 / (1 + np.exp(-x[:2]))
        params = reference.Params(theta_i, theta_tau / 2, np.exp(x[2:]))
        evidence, squares = expected(sequences, i, params, jump)
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
    ways = [np.linspace(0, 6, n) for n in TUNED_LENGTHS]
    sensors = [np.column_stack([w, 0 * w]) + 0.3 * rng.normal(size=(len(w), 2)) for w in ways]
    commands = [np.column_stack([np.sin(w), np.cos(w), 0 * w + 7]) for w in ways]
    return Records.from_sequences(sensors, commands)


def test_the_optimisation_comes_to_the_best_of_a_grid(paced):
    """Of the two σ; within a tenth of what there is to gain."""
    *_, end = optimise.optimise(paced, default_params(paced), "own_tau", steps=40)
    across = np.geomspace(0.04, 4, 5)

    def errors(sigmas):
        thetas = [np.full(5, theta) for theta in (end.theta_i, end.theta_tau)]
        return leave_one_out(paced, Params(*thetas, sigmas), "own_tau").command_error

    best = min(errors(np.column_stack([np.full(5, a), across])).min() for a in across)
    before, *_, after = errors(np.geomspace(default_params(paced).sigma, end.sigma, 5))
    assert best < 0.8 * before
    assert after - best < 0.1 * (before - best)


def test_evidence_drives_the_sigma_of_what_repeats_itself_to_the_least(paced, monkeypatch):
    monkeypatch.setattr(optimise, "SIGMA_BOUNDS", (0.05, 10.0))
    sensors, commands = paced.sequences()
    sensors = [np.column_stack([s[:, 0], np.arange(len(s)) // 8 % 2]) for s in sensors]
    repeating = Records.from_sequences(sensors, commands)
    *_, end = optimise.optimise(
        repeating, default_params(repeating), "own_tau", "evidence", steps=30
    )
    assert end.sigma[1] == pytest.approx(0.05, rel=1e-5)


@pytest.mark.parametrize("score", optimise.SCORES)
def test_the_path_does_not_depend_on_the_records_offset(sequences, records, score):
    far = Records.from_sequences(*far_from_zero(sequences))
    assert all(far.offset)
    start = Params(0.125, 0.0625, SIGMA)
    for params, want in zip(
        optimise.optimise(far, start, "own_tau", score, steps=3),
        optimise.optimise(records, start, "own_tau", score, steps=3),
        strict=True,
    ):
        for a, b in zip(jax.tree.leaves(params), jax.tree.leaves(want), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-4)


def test_gradients_do_not_depend_on_the_records_offset(sequences, records):
    far = Records.from_sequences(*far_from_zero(sequences))
    x, scale = optimise._unconstrained(Params(0.125, 0.0625, SIGMA)), command_scale(records)
    gradients = [
        optimise._gradient(
            x,
            leave_out(r, 1).centred(),
            optimise._rows(r)[1],
            scale,
            np.array([1.0, 0.01]),
            "own_tau",
        )
        for r in (records, far)
    ]
    for want, a in zip(*gradients, strict=True):
        np.testing.assert_allclose(a, want, rtol=1e-3)
        assert np.any(np.abs(want) > 1e-3)
