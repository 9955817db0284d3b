"""Every step of a replay agrees with the reference; what init, predict, update and ends return."""

import dataclasses
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from filter_helpers import (
    assert_agree,
    both_precisions,
    both_readings,
    noise,
    passing,
    run,
    run_reference,
    tolerance,
    x64,
)
from hypothesis import given
from hypothesis import strategies as st
from random_helpers import LENGTHS, N_SENSORS, as_float32, random_sequences

from jaxreplay import Params, Records, build_filter
from jaxreplay.filter.belief import NOTHING_DROPPED
from jaxreplay.filter.numerics.scaled import scaled
from jaxreplay.filter.transition import record_transition

SIGMA = np.array([0.5, 2.0])
STEPS = 30


@cache
def scenario(name):
    """Sensors, commands and observations that float32 represents exactly."""
    sensors, commands = random_sequences(1)
    zs = passing(sensors[0], SIGMA, STEPS)
    if name == "random, the longest last":
        sensors, commands = random_sequences(2, LENGTHS[::-1])
        zs = passing(sensors[2], SIGMA, STEPS)
    elif name == "far":
        sides = np.sign(noise(1, STEPS, N_SENSORS))
        highest = np.max([s.max(0) for s in sensors], axis=0)
        lowest = np.min([s.min(0) for s in sensors], axis=0)
        reach = SIGMA * np.linspace(0, 10, STEPS)[:, None]
        zs = np.where(sides > 0, highest + reach, lowest - reach)
    elif name == "samples far apart":
        sensors, commands = random_sequences(3, step=30)
        zs = passing(sensors[0], SIGMA, STEPS)
    elif name == "near duplicates":
        base, commands = random_sequences(4, (200, 200, 150, 35))
        sensors = [base[0][: len(s)] + 1e-3 * noise(i, *s.shape) for i, s in enumerate(base)]
        zs = passing(sensors[0], SIGMA, STEPS)
    elif name == "samples nearly equal":
        _, commands = random_sequences(5, (200, 200, 200, 39))
        apart = [0, 1e-30, 1e-7, 1e-3]
        sensors = [
            SIGMA * d * noise(i, len(c), N_SENSORS).cumsum(0)
            for i, (d, c) in enumerate(zip(apart, commands, strict=True))
        ]
        sensors[2][::2] += SIGMA  # every other segment is long, the rest no longer than 1e-7 σ
        sensors[2][1::2] = sensors[2][::2]
        sensors[3] += 0.5
        zs = 2 * SIGMA * noise(6, STEPS, N_SENSORS)
    elif name == "all short":
        sensors, commands = random_sequences(6, (200, 1, 2, 1))
        sensors[0] += 20
        zs = passing(sensors[2], SIGMA, STEPS)
    return [as_float32(s) for s in sensors], commands, as_float32(zs)


SCENARIOS = (
    "random",
    "random, the longest last",
    "far",
    "samples far apart",
    "near duplicates",
    "samples nearly equal",
    "all short",
)
THETAS = [
    (0, 0.05),
    (1e-30, 0.05),
    (0.1, 0.0),
    (0.1, 0.05),
    (0.1, 0.5),
    (1, 0.05),
    (0, 0),
    (1, 0.5),
]


@cache
def expected(name, theta_i, theta_tau, jump):
    *sequences, zs = scenario(name)
    thetas = as_float32([theta_i, theta_tau])
    return run_reference(sequences, zs, *thetas, SIGMA, jump)


@both_readings
@both_precisions
@pytest.mark.parametrize("thetas", THETAS[:4])
@pytest.mark.parametrize("name", SCENARIOS)
def test_every_step_agrees_with_the_reference(name, thetas, precision, jump):
    check_every_step(name, thetas, precision, jump)


@both_readings
@both_precisions
@pytest.mark.parametrize("thetas", THETAS[4:])
@pytest.mark.parametrize("name", SCENARIOS[:2])
def test_every_step_agrees_with_the_reference_for_extreme_thetas(name, thetas, precision, jump):
    check_every_step(name, thetas, precision, jump)


def check_every_step(name, thetas, precision, jump):
    *sequences, zs = scenario(name)
    with x64(precision):
        params = Params(*as_float32(thetas), SIGMA)
        got, _ = run(build_filter(jump), sequences, zs, params)
    assert got[0].dtype == precision
    allowed = tolerance(sequences[0], zs, SIGMA, precision)
    assert_agree(got, expected(name, *thetas, jump), allowed, precision)


@pytest.mark.parametrize(
    ("jump", "precision"),
    [("same_tau", "float32"), pytest.param("own_tau", "float64", marks=pytest.mark.slow)],
)
def test_one_record_agrees_with_the_reference(jump, precision):
    sequences = random_sequences(7, (200,))
    zs = as_float32(passing(sequences[0][0], SIGMA, STEPS))
    with x64(precision):
        got, _ = run(build_filter(jump), sequences, zs, Params(0.5, 0.125, SIGMA))
    want = run_reference(sequences, zs, 0.5, 0.125, SIGMA, jump)
    assert_agree(got, want, tolerance(sequences[0], zs, SIGMA, precision), precision)


def test_one_record_has_nowhere_to_jump():
    mass = scaled(jnp.array([[0.25, 0.5, 1e-30]]))
    after = record_transition(Params(0.7, 0.1, SIGMA), mass)
    np.testing.assert_array_equal(after.value(), mass.value())


@both_readings
def test_belief_starts_at_the_first_sample_of_every_record(jump):
    records, f = Records.from_sequences(*random_sequences()), build_filter(jump)
    belief = f.init(records)
    np.testing.assert_array_equal(f.posterior(records, belief), 0.25 * np.eye(1, 200).repeat(4, 0))
    assert belief.dropped == NOTHING_DROPPED


def test_jumps_that_all_land_past_the_end_keep_the_belief():
    records, f = Records.from_sequences(*random_sequences()), build_filter("same_tau")
    p = np.zeros((4, 200), np.float32)
    p[0, [33, 36]] = 0.25, 0.75  # the other records have 31, 2 and 1 samples
    belief = dataclasses.replace(f.init(records), p=scaled(jnp.asarray(p)))
    after = f.predict(records, Params(1, 0.05, SIGMA), belief)
    np.testing.assert_array_equal(f.posterior(records, after), p)


def test_end_probability_counts_the_last_ten_moments_and_short_records_whole():
    records, f = Records.from_sequences(*random_sequences()), build_filter("same_tau")
    counted = np.zeros((4, 200), bool)
    counted[0, 190:] = counted[1, 21:31] = counted[2, :2] = counted[3, 0] = True
    for i, j in [(0, 189), (0, 190), (0, 199), (1, 20), (1, 21), (1, 30), (2, 0), (2, 1), (3, 0)]:
        p = np.zeros((4, 200), np.float32)
        p[i, j] = 1
        belief = dataclasses.replace(f.init(records), p=scaled(jnp.asarray(p)))
        assert f.end_probability(records, belief) == counted[i, j], (i, j)


@both_readings
@given(
    seed=st.integers(0, 2**32 - 1),
    theta_i=st.floats(0, 1),
    theta_tau=st.floats(0, 0.5),
    scale=st.sampled_from([1e-3, 0.1, 1, 30]),
    away=st.sampled_from([0, 3, 30, 1e4]),
)
def test_distributions_sum_to_1(jump, seed, theta_i, theta_tau, scale, away):
    sequences, f = random_sequences(seed, step=scale), build_filter(jump)
    records = Records.from_sequences(*sequences)
    params = Params(theta_i, theta_tau, SIGMA)
    padding = np.arange(200) >= np.array(LENGTHS)[:, None]
    belief = f.init(records)
    for z in away * SIGMA * noise(seed, 4, N_SENSORS):
        belief = f.predict(records, params, belief)
        after, log_evidence = f.update(records, params, belief, z)
        for p in (f.posterior(records, belief), f.posterior(records, after)):
            assert np.sum(p) == pytest.approx(1, abs=1e-5)
            assert np.min(p) >= 0
            assert not np.any(np.asarray(p)[padding])
        assert np.isfinite(log_evidence)
        belief = after


@pytest.mark.parametrize("z", [0.0, [1.0, 2.0, 3.0], [[1.0, 2.0]]])
def test_observation_of_another_shape_is_an_error(z):
    records, f = Records.from_sequences(*random_sequences()), build_filter()
    shape = str(np.shape(z)).replace("(", r"\(").replace(")", r"\)")
    with pytest.raises(ValueError, match=rf"z has shape {shape}; .* 2 sensors \(z0, z1\)"):
        f.update(records, Params(0.1, 0.05, SIGMA), f.init(records), z)


def test_sigma_of_another_shape_is_an_error():
    records, f = Records.from_sequences(*random_sequences()), build_filter()
    with pytest.raises(ValueError, match=r"sigma has shape \(1,\); .* 2 sensors"):
        f.update(records, Params(0.1, 0.05, SIGMA[:1]), f.init(records), np.zeros(2))


def test_a_filter_must_be_one_of_the_two_readings_with_a_window_that_can_move():
    with pytest.raises(ValueError, match="same_tau, own_tau; got 'both'"):
        build_filter("both")
    with pytest.raises(ValueError, match="at least 32 samples; got 31"):
        build_filter(window=31)
