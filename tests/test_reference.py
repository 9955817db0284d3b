from itertools import pairwise, product
from math import erf, exp, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_helpers import random_sequences
from scipy.integrate import quad

from jaxreplay import reference

SIGMA = np.array([0.7, 1.3])
THETA_I, THETA_TAU = 0.3, 0.1
PARAMS = reference.Params(THETA_I, THETA_TAU, SIGMA)


def density(z, t, sigma):
    return exp(-(((z - t) / sigma) ** 2) / 2) / (sigma * sqrt(2 * pi))


def segment_by_erf(z, a, b, sigma):
    if a == b:
        return density(z, a, sigma)
    return (erf((b - z) / sigma / sqrt(2)) - erf((a - z) / sigma / sqrt(2))) / 2 / (b - a)


def segment_by_quadrature(z, a, b, sigma):
    a, b = min(a, b), max(a, b)
    if a == b:
        return density(z, a, sigma)
    nearest, steps = np.clip(z, a, b), sigma * 2.0 ** np.arange(-8, 8)
    cuts = np.concatenate([[a, b, nearest], nearest - steps, nearest + steps])
    cuts = np.unique(cuts[(a <= cuts) & (cuts <= b)])
    areas = [
        quad(lambda t: density(z, t, sigma), *piece, epsabs=0, epsrel=1e-10)[0]
        for piece in pairwise(cuts)
    ]
    return sum(areas) / (b - a)


def observation(z, record, j, segment):
    """Equation 2 as printed, for 0 < j < last; one segment of full weight at the ends."""
    likelihood = 1.0
    for k, s in enumerate(SIGMA):
        zeta = record[:, k]
        ends = [(zeta[m], zeta[m + 1]) for m in (j - 1, j) if 0 <= m < len(zeta) - 1]
        around = [segment(z[k], a, b, s) for a, b in ends or [(zeta[0], zeta[0])]]
        likelihood *= np.mean(around)
    return likelihood


def jump(to, of, n):
    return 1 - THETA_I if to == of else THETA_I / (n - 1)


def advance(to, of, length):
    """Equation 4 within a record whose last sample absorbs."""
    steps = {0: THETA_TAU, 1: 1 - 2 * THETA_TAU, 2: THETA_TAU}
    return sum(p for step, p in steps.items() if min(of + step, length - 1) == to)


def sums_over_paths(sensors, zs):
    """Equation 1 summed over all paths: the states' weights before and after the last z."""
    n, longest = len(sensors), max(map(len, sensors))
    before, after = np.zeros((2, n, longest))
    states = [(i, j) for i in range(n) for j in range(len(sensors[i]))]
    seen = [{(i, j): observation(z, sensors[i], j, segment_by_erf) for i, j in states} for z in zs]
    for path in product(states, repeat=len(zs)):
        for first in range(n):
            weight, (i, j) = 1 / n, (first, 0)
            for t, (i_next, j_next) in enumerate(path):
                weight *= jump(i_next, i, n) * advance(j_next, j, len(sensors[i]))
                i, j = i_next, j_next
                if t < len(zs) - 1:
                    weight *= seen[t][i, j]
                if weight == 0:
                    break
            before[i, j] += weight
            after[i, j] += weight * seen[-1][i, j]
    return before, after


@pytest.mark.parametrize("lengths", [(4, 4), (4, 2), (1, 3), (2, 2, 3)])
def test_same_tau_is_equation_1_summed_over_all_paths(lengths):
    sensors, _ = random_sequences(1, lengths)
    zs = sensors[0][[0, -1, -1, -1]] + 0.3
    if len(lengths) > 2:
        zs = zs[:3]
    belief = reference.init(sensors)
    total = 0.0
    for t in range(1, len(zs) + 1):
        predicted = reference.predict(sensors, PARAMS, belief, "same_tau")
        belief, log_evidence = reference.update(sensors, PARAMS, predicted, zs[t - 1])
        before, after = sums_over_paths(sensors, zs[:t])
        np.testing.assert_allclose(np.exp(predicted), before / before.sum(), rtol=1e-10)
        np.testing.assert_allclose(np.exp(belief), after / after.sum(), rtol=1e-10)
        assert log_evidence == pytest.approx(np.log(after.sum() / before.sum()), rel=1e-10)
        total += log_evidence
    if len(set(lengths)) == 1:  # nothing is dropped: the evidence is that of equation 1 itself
        assert total == pytest.approx(np.log(after.sum()), rel=1e-10)
    else:
        assert np.log(after.sum()) < total - 1e-3


def test_own_tau_is_the_product_of_two_factors():
    lengths = (5, 4, 2, 1)
    sensors, _ = random_sequences(2, lengths)
    p = np.zeros((4, 5))
    rng = np.random.default_rng(0)
    for i, length in enumerate(lengths):
        p[i, :length] = rng.random(length)
    p /= p.sum()
    expected = np.zeros_like(p)
    for i, length in enumerate(lengths):
        weight = sum(jump(i, of, 4) * p[of].sum() for of in range(4))
        for j in range(length):
            arrive = sum(advance(j, of, length) * p[i, of] / p[i].sum() for of in range(length))
            expected[i, j] = weight * arrive
    with np.errstate(divide="ignore"):
        predicted = reference.predict(sensors, PARAMS, np.log(p), "own_tau")
    np.testing.assert_allclose(np.exp(predicted), expected, rtol=1e-12)


def test_the_readings_differ_once_records_stand_at_different_moments():
    sensors, _ = random_sequences(2, (5, 5))
    with np.errstate(divide="ignore"):
        belief = np.log(0.5 * np.eye(2, 5))
    readings = [
        reference.predict(sensors, PARAMS, belief, jump) for jump in ("same_tau", "own_tau")
    ]
    assert np.abs(np.exp(readings[0]) - np.exp(readings[1])).max() > 0.05


def test_jumps_that_all_land_past_the_end_keep_the_belief():
    sensors, _ = random_sequences(2, (6, 2))
    belief = np.full((2, 6), -np.inf)
    belief[0, 3] = 0.0
    always_a_jump = PARAMS._replace(theta_i=1.0)
    after = reference.predict(sensors, always_a_jump, belief, "same_tau")
    np.testing.assert_array_equal(after, belief)


@pytest.mark.parametrize("length", [0, 1e-9, 1e-5, 9e-4, 1.1e-3, 0.1, 1, 30, 1000])
@pytest.mark.parametrize("distance", [0, 0.3, 3, 30])
@pytest.mark.parametrize("sigma", [0.01, 5.0])
def test_segment_mean_is_the_integral(length, distance, sigma):
    start, z = 2.0, 2.0 - distance * sigma
    end = start + length * sigma
    for a, b, at in [(start, end, z), (end, start, z), (start, end, end + distance * sigma / 2)]:
        expected = np.log(segment_by_quadrature(at, a, b, sigma))
        mean = reference.segment_mean(at, np.array(a), np.array(b), sigma)
        assert mean == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("part", [0, 1e-4, 0.3, 0.5, 1])
@pytest.mark.parametrize("length", [1e-5, 0.01, 1, 30, 1000])
def test_segment_mean_is_the_integral_for_z_inside(length, part):
    sigma, start = 0.5, -1.0
    end = start + length * sigma
    z = start + part * (end - start)
    expected = np.log(segment_by_quadrature(z, start, end, sigma))
    mean = reference.segment_mean(z, np.array(start), np.array(end), sigma)
    assert mean == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("length", [1, 2, 3, 6])
def test_likelihood_is_equation_2_integrated_numerically(length):
    sensors, _ = random_sequences(3, (length,))
    for z in sensors[0][0] + np.array([[0, 0], [0.2, -1], [-8, 8]]):
        expected = [
            np.log(observation(z, sensors[0], j, segment_by_quadrature)) for j in range(length)
        ]
        np.testing.assert_allclose(reference.likelihood(sensors, PARAMS, z), [expected], rtol=1e-9)


@pytest.mark.parametrize("jump", ["same_tau", "own_tau"])
@given(
    seed=st.integers(0, 2**32 - 1),
    lengths=st.lists(st.integers(1, 12), min_size=1, max_size=4),
    theta_i=st.floats(0, 1),
    theta_tau=st.floats(0, 0.5),
)
def test_distributions_sum_to_1(jump, seed, lengths, theta_i, theta_tau):
    sensors, _ = random_sequences(seed, lengths)
    params = reference.Params(theta_i, theta_tau, SIGMA)
    belief = reference.init(sensors)
    assert np.exp(belief).sum() == pytest.approx(1)
    for z in random_sequences(seed + 1, (4,))[0][0]:
        belief = reference.predict(sensors, params, belief, jump)
        assert np.exp(belief).sum() == pytest.approx(1)
        belief, _ = reference.update(sensors, params, belief, z)
        assert np.exp(belief).sum() == pytest.approx(1)
    for i, length in enumerate(lengths):
        assert (belief[i, length:] == -np.inf).all()


def test_command_and_end_probability_are_expectations():
    sensors, commands = random_sequences(4, (13, 3))
    p = np.zeros((2, 13))
    p[0, [0, 2, 3, 12]] = 0.1, 0.2, 0.3, 0.1
    p[1, [0, 2]] = 0.05, 0.25
    with np.errstate(divide="ignore"):
        belief = np.log(p)
    expected = sum(p[i, j] * commands[i][j] for i, j in np.argwhere(p))
    np.testing.assert_allclose(reference.command(commands, belief), expected, rtol=1e-12)
    assert reference.end_probability(sensors, belief) == pytest.approx(0.3 + 0.1 + 0.3)
