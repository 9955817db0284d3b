"""The log evidence of a whole sequence is the sum of its steps' in the reference."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filter_helpers import own_tau_first
from random_helpers import random_sequences

from jaxreplay import Params, Records, log_evidence, reference

SIGMA = np.array([0.5, 2.0])


@pytest.fixture(scope="module")
def recorded():
    sensors, commands = random_sequences(12, (200, 31, 2, 1))
    seen = sensors[0][:50] + 0.25 * np.round(np.random.default_rng(0).normal(size=(50, 2)))
    return sensors, Records.from_sequences(sensors, commands), seen


def expected(sensors, params, observations, jump):
    belief, total = reference.init(sensors), 0.0
    for z in observations:
        belief = reference.predict(sensors, params, belief, jump)
        belief, gained = reference.update(sensors, params, belief, z)
        total += gained
    return total


@own_tau_first
def test_it_is_the_references_over_grids_and_lengths(recorded, jump):
    sensors, records, seen = recorded
    theta_i, theta_tau = np.array([0.5, 0.125, 1e-6]), np.array([0.0625, 0.25, 0.03125])
    sigma = SIGMA * np.array([[1], [2], [0.5]])
    lengths = [50, 20, 1]
    padded = np.stack([np.where(np.arange(50)[:, None] < n, seen, np.nan) for n in lengths])
    ours = jax.vmap(lambda p, z: log_evidence(records, p, z, jump))(
        Params(theta_i, theta_tau, sigma), padded
    )
    for got, i, tau, s, n in zip(ours, theta_i, theta_tau, sigma, lengths, strict=True):
        params = reference.Params(float(np.float32(i)), float(tau), s)
        assert got == pytest.approx(expected(sensors, params, seen[:n], jump), rel=1e-5)


def test_observations_far_from_0_may_be_jax_arrays_that_are_exact():
    far = [[2.0**14, -(2.0**12)] + np.round(16 * s) / 16 for s in random_sequences(12, (9, 4))[0]]
    records = Records.from_sequences(far, random_sequences(12, (9, 4))[1])
    assert any(records.offset)
    params = Params(0.125, 0.0625, SIGMA)
    got = log_evidence(records, params, jnp.asarray(far[0]))
    assert got == log_evidence(records, params, far[0])


@pytest.mark.slow
def test_a_better_sigma_has_more_evidence_and_the_gradient_says_where(recorded):
    _, records, seen = recorded

    def evidence(sigma):
        return log_evidence(records, Params(0.125, 0.0625, sigma), seen)

    gradient = jax.grad(evidence)(SIGMA.astype(np.float32))
    assert np.isfinite(gradient).all()
    better = SIGMA + 1e-2 * np.asarray(gradient) / np.abs(gradient).max()
    assert evidence(better) > evidence(SIGMA)


def test_observations_of_another_shape_are_an_error(recorded):
    _, records, seen = recorded
    with pytest.raises(ValueError, match=r"shape \(50, 1\); \(T, 2\) is needed"):
        log_evidence(records, Params(0.1, 0.05, SIGMA), seen[:, :1])
