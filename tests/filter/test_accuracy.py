"""Whole runs agree with the reference up to 30 σ from the records, and stay sensible farther."""

from functools import cache

import numpy as np
import pytest
from filter_helpers import (
    Case,
    assert_agree,
    both_readings,
    case,
    far_tolerance,
    noise,
    own_tau_first,
    params_of,
    run,
    run_reference,
    tolerance,
    x64,
)
from hypothesis import given
from hypothesis import strategies as st
from random_helpers import as_float32
from scipy.special import logsumexp

from jaxreplay import build_filter, reference

SIGMA = as_float32([0.7, 2.3])
N, LONGEST = 4, 60  # one shape for most cases, so that JAX compiles once
STALL = 500


def constant(*stays):
    """Observations that are constant for some steps, given as pairs (observation, steps)."""
    places, steps = zip(*stays, strict=True)
    return np.repeat(np.array(places, float), steps, axis=0)


def mirrored(k=30):
    """k steps at one record, k at another 1000 σ away, which draws level; exact in float32."""
    wiggle = np.round(2**8 * noise(0, LONGEST, 2)) / 2**10
    far = np.round(1000 * SIGMA * 2**10) / 2**10
    near = wiggle + 2**-8
    sensors = [wiggle, far - wiggle, near, far - near]
    at = np.full(2, 0.125)
    return case(sensors, constant((at, k), (far - at, k + 5)), SIGMA, theta_i=0)


def midway():
    """As near to two pairs of records 1000 σ apart as makes no difference to either."""
    levels = [0, 1000, 0, 1000]
    sensors = [SIGMA * (level + 1e-3 * noise(i, LONGEST, 2)) for i, level in enumerate(levels)]
    return case(sensors, SIGMA * (500 + 3e-4 * noise(9, 120, 2)), SIGMA, theta_i=1e-30)


def far_from_near_duplicates(theta_i):
    """Records 10^-3 or 10^-7 σ apart, or nothing, seen from up to 1000 σ away and back."""
    base = 0.1 * noise(1, LONGEST, 2).cumsum(0)
    apart = [0, 1e-3, 1e-7, 1e-3]
    sensors = [SIGMA * (base + d * noise(i, LONGEST, 2)) for i, d in enumerate(apart)]
    away = np.concatenate([np.linspace(0, 1000, 60), np.linspace(1000, 0, 60)])[:, None]
    return case(sensors, SIGMA * (away + noise(7, 120, 2)), SIGMA, theta_i)


def far_apart(theta_i):
    """Samples 1000 σ apart: on them, next to them and between them."""
    rng = np.random.default_rng(2)
    sensors = [1000 * SIGMA * rng.integers(0, 4, (LONGEST, 2)) for _ in range(N)]
    at = rng.integers(0, LONGEST - 1, 90)
    between = np.array([0, 0.5, 1e-3, 0.999, 1.0])[np.arange(90) % 5, None]
    zs = sensors[0][at] * (1 - between) + sensors[0][at + 1] * between
    return case(sensors, zs + SIGMA * noise(3, 90, 2), SIGMA, theta_i)


def left_behind(away, theta_tau):
    """500 equal observations `away` from all records but one, then at one of them after all.

    Which of its moments that record has come to was decided by likelihoods of almost nothing.
    """
    slope = np.linspace(1, away, LONGEST)[:, None]
    sensors = [
        np.zeros((LONGEST, 2)),
        SIGMA * (slope + 0.01 * noise(0, LONGEST, 2)),
        SIGMA * (slope[::-1] + 0.01 * noise(1, LONGEST, 2)),
        SIGMA * (away + 0.01 * noise(2, LONGEST, 2)),
    ]
    back = constant((SIGMA * away, 5), (sensors[1][8], 5), (sensors[2][30], 5))
    zs = np.concatenate([np.full((STALL, 2), 0.1), back])
    return case(sensors, zs, SIGMA, 0.01, theta_tau)


def stalled(theta_i=0.1, theta_tau=0.05, stall=100, scale=1.0, offset=0.0):
    """Along a record, at one place for many steps, and on to its end, among others like it."""
    base = 0.3 * noise(0, LONGEST, 2).cumsum(0)
    sensors = [(base + 0.5 * noise(i, LONGEST, 2))[:n] for i, n in enumerate((60, 55, 60, 31), 1)]
    way = sensors[2] + 0.3 * noise(9, LONGEST, 2)
    zs = np.concatenate([way[:25], np.tile(way[25], (stall, 1)), way[26:]])
    sigma = as_float32(SIGMA * scale)
    sensors = [s * sigma + offset for s in sensors]
    return case(sensors, zs * sigma + offset, sigma, theta_i, theta_tau)


def equally_far(n_sensors, away):
    """Records as far from all observations, in different directions: a draw to the end."""
    sigma = as_float32(np.random.default_rng(0).uniform(0.3, 3, n_sensors))
    directions = noise(1, N, n_sensors)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sensors = [np.tile(away * d * sigma, (LONGEST, 1)) for d in directions]
    return case(sensors, np.zeros((200, n_sensors)), sigma, theta_i=0)


def many_sensors(n_sensors):
    """Records that differ by little in each of many sensors, some of them missing at times."""
    sigma = as_float32(np.random.default_rng(0).uniform(0.3, 3, n_sensors))
    base = 0.1 * noise(1, LONGEST, n_sensors).cumsum(0)
    sensors = [sigma * (base + 0.1 * noise(i, LONGEST, n_sensors)) for i in range(N)]
    at = np.concatenate([np.arange(20), np.full(140, 20), np.arange(20, 60)])
    zs = sensors[1][at] + sigma * np.repeat(noise(8, 20, n_sensors), 10, axis=0)
    zs[::7, 0] = np.nan
    return case(sensors, zs, sigma)


def one_sample_records():
    rng = np.random.default_rng(4)
    sensors = [SIGMA * rng.normal(size=(n, 2)) for n in (LONGEST, 1, 1, 1)]
    zs = constant(*((sensors[i][0] + 0.1, 40) for i in (1, 0, 3, 2)))
    return case(sensors, zs, SIGMA)


def lengths_from_1_to_5000():
    """64 records; observations pass the longest and then the second."""
    lengths = [5000, 300, *np.random.default_rng(0).integers(1, 300, 61), 1]
    sensors = [0.5 * SIGMA * noise(i, n, 2).cumsum(0) for i, n in enumerate(lengths)]
    zs = np.concatenate([sensors[0][:12], sensors[1][12:24]])
    return case(sensors, zs + 0.3 * SIGMA * noise(99, 24, 2), SIGMA, theta_tau=0.25)


def all_of_5000():
    """From the first to the last of 5,000 samples, a stall on the way."""
    sensors = [0.3 * SIGMA * noise(i, n, 2).cumsum(0) for i, n in enumerate((5000, 1))]
    at = np.concatenate([np.arange(2000), np.full(STALL, 2000), np.arange(2000, 5000)])
    return case(sensors, sensors[0][at] + SIGMA * noise(9, len(at), 2), SIGMA, theta_tau=0.25)


CASES = {
    "mirrored": mirrored,
    "midway": midway,
    "near duplicates from far": lambda: far_from_near_duplicates(0.1),
    "near duplicates from far, no jumps": lambda: far_from_near_duplicates(0),
    "samples far apart": lambda: far_apart(0.1),
    "samples far apart, jumps of 1e-30": lambda: far_apart(1e-30),
    "left 5 σ behind": lambda: left_behind(5, 0.05),
    "left 20 σ behind": lambda: left_behind(20, 0.5),
    "left 50 σ behind": lambda: left_behind(50, 0.3),
    "stalled": lambda: stalled(stall=STALL),
    "stalled, no jumps": lambda: stalled(0, 0.5, STALL),
    "stalled, jumps of 1e-30": lambda: stalled(1e-30),
    "stalled, always a jump": lambda: stalled(1, 0.25),
    "stalled, always one sample on": lambda: stalled(0.3, 0),
    "values of 1e6 and of 1e-6": lambda: stalled(scale=np.array([1e6, 1e-6])),
    "values of 1e-6 and of 1e6": lambda: stalled(scale=np.array([1e-6, 1e6])),
    "equally far, 5 σ": lambda: equally_far(2, 5),
    "equally far, 50 σ": lambda: equally_far(2, 50),
    "one-sample records": one_sample_records,
}
OTHERS = {  # each compiled for itself
    "values far from 0": lambda: stalled(offset=np.array([1e4, -1e4])),
    "lengths from 1 to 5000": lengths_from_1_to_5000,
    "1 sensor": lambda: many_sensors(1),
    "7 sensors": lambda: many_sensors(7),
    "20 sensors": lambda: many_sensors(20),
    "7 sensors, equally far": lambda: equally_far(7, 30),
    "20 sensors, equally far": lambda: equally_far(20, 30),
}
MORE_THAN_30_AWAY = ("mirrored", "midway", "from far", "far apart", "50 σ")
UP_TO_30 = [name for name in CASES if not any(part in name for part in MORE_THAN_30_AWAY)]
# Records that compete while all, or all but one, are far from the observations: rounding adds up.
FAR = ("mirrored", "midway", "left 50 σ", "equally far, 50 σ")


@cache
def made(name) -> Case:
    return (CASES | OTHERS)[name]()


@cache
def expected(name, jump):
    sensors, commands, zs, *params = made(name)
    return run_reference((sensors, commands), zs, *params, jump)


def check(case, want, jump, precision="float32", far=False):
    sensors, commands, zs, *_, sigma = case
    with x64(precision):
        got, _ = run(build_filter(jump), (sensors, commands), zs, params_of(case))
    assert got[0].dtype == precision
    more = far_tolerance(sensors, zs, sigma) if far else 0.0
    assert_agree(got, want, tolerance(sensors, zs, sigma, precision), precision, more)


@both_readings
@pytest.mark.parametrize("name", CASES)
def test_float32_agrees_with_the_reference(name, jump):
    check(made(name), expected(name, jump), jump, far=name.startswith(FAR))


@own_tau_first
@pytest.mark.parametrize("name", OTHERS)
def test_float32_agrees_with_the_reference_in_other_shapes(name, jump):
    check(made(name), expected(name, jump), jump, far="equally far" in name)


@both_readings
@pytest.mark.parametrize("name", ["mirrored", "midway", "equally far, 50 σ"])
def test_the_right_record_wins_where_its_lead_exceeds_the_error(name, jump):
    sensors, commands, zs, *params = made(name)
    case, at = made(name), reference.Params(*params)
    (posterior, *_), _ = run(build_filter(jump), (sensors, commands), zs, params_of(case))
    error, belief, clear = far_tolerance(sensors, zs, at.sigma), reference.init(sensors), 0
    for t, z in enumerate(zs):
        belief, _ = reference.update(sensors, at, reference.predict(sensors, at, belief, jump), z)
        logs = logsumexp(belief, axis=1)
        if np.diff(np.sort(logs))[-1] > 2 * error[t]:
            assert posterior[t].sum(1).argmax() == logs.argmax()
            clear += 1
    assert clear >= {"mirrored": 30, "midway": 1, "equally far, 50 σ": 0}[name]


@own_tau_first
@pytest.mark.parametrize(
    "name",
    [
        name if k % 2 == 0 else pytest.param(name, marks=pytest.mark.slow)
        for k, name in enumerate(UP_TO_30)
    ],
)
def test_float64_agrees_with_the_reference(name, jump):
    check(made(name), expected(name, jump), jump, "float64")


@both_readings
@pytest.mark.slow
def test_a_run_along_5000_samples_agrees_with_the_reference(jump):
    case = all_of_5000()
    sensors, commands, zs, *params = case
    check(case, run_reference((sensors, commands), zs, *params, jump), jump)


def test_a_stall_of_500_steps_is_made_up_for_in_as_many_1000_σ_away():
    sensors = [np.zeros((LONGEST, 1)), np.full((LONGEST, 1), 1000.0), *np.full((2, 1, 1), -1000.0)]
    zs = constant(([0.0], STALL), ([1000.0], STALL + 3))
    far = case(sensors, zs, np.ones(1), theta_i=0)
    (posterior, *_), _ = run(build_filter(), far[:2], zs, params_of(far))
    winners = posterior.sum(2).argmax(1)
    np.testing.assert_array_equal(winners[:-4], 0)
    np.testing.assert_array_equal(winners[-2:], 1)


CORNERS = SIGMA * [[-1, -1], [-1, 1], [1, -1], [1, 1]]


@both_readings
@given(
    exponent=st.floats(1, 37.8),
    direction=st.integers(0, 3),
    back=st.integers(0, 3),
    theta_i=st.sampled_from([1e-30, 1e-3, 0.5]),
    apart=st.sampled_from([1, 5, 30]),
)
def test_any_distance_has_its_winner_and_can_be_returned_from(
    jump, exponent, direction, back, theta_i, apart
):
    sensors = [np.tile(10 * apart * corner, (LONGEST, 1)) for corner in CORNERS]
    away = 10.0**exponent * CORNERS[direction]
    zs = constant((away, 3), (sensors[back][0], 5))
    far = case(sensors, zs, SIGMA, theta_i)
    (posterior, command, log_evidence, _), _ = run(
        build_filter(jump), far[:2], far.zs, params_of(far)
    )
    assert np.isfinite(posterior).all()
    assert np.isfinite(command).all()
    assert np.isfinite(log_evidence).all()
    np.testing.assert_allclose(posterior.sum((1, 2)), 1, atol=1e-5)
    weights = posterior.sum(2)
    assert weights[2].argmax() == direction
    assert weights[-1, back] > 0.9


@pytest.mark.parametrize(("away", "sigma"), [(1e20, 1), (3e38, 1), (1e20, 1e-20)])
def test_nothing_is_infinite_however_far_the_observation(away, sigma):
    sensors = [np.full((LONGEST, 2), level) for level in (0.0, 1.0, 2.0, 3.0)]
    far = case(sensors, constant(([away, away], 2), ([3.0, 3.0], 2)), as_float32([sigma, sigma]))
    got, _ = run(build_filter(), far[:2], far.zs, params_of(far))
    assert all(np.isfinite(values).all() for values in got)
