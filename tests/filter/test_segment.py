"""The means of one segment and of two, the list of long segments, and what they are made of."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filter_helpers import both_precisions, x64
from hypothesis import given
from hypothesis import strategies as st

from jaxreplay import Params, Records, build_filter, reference
from jaxreplay.filter.numerics import long_segments
from jaxreplay.filter.numerics.polynomial import fit_quotients
from jaxreplay.filter.numerics.scaled import exp, exp_minus
from jaxreplay.filter.numerics.segment import (
    LONG,
    Mean,
    Sensor,
    long_mean,
    mean_of_two,
    short_mean,
)
from jaxreplay.filter.observation import likelihood
from jaxreplay.filter.window import view
from jaxreplay.records import CHUNK, LongestFirst

SIGMA = 0.5
TOLERANCE = {"float32": 3e-6, "float64": 1e-10}  # the latter that of the reference
distances = st.floats(-40, 40)
jitted = {f: jax.jit(f) for f in (short_mean, long_mean, mean_of_two, exp, exp_minus)}


def log_mean(mean):
    peak, factor = (np.asarray(x, np.float64) for x in mean)
    return peak + np.log(factor)


def agree(function, precision, start, length, z, anchor):
    """The log mean is the reference's; all arguments but z are from z, in σ."""
    with x64(precision):
        ends = [jnp.asarray(z + SIGMA * x, precision) for x in (start, start + length)]
        sensor = Sensor(*(jnp.asarray(x, precision) for x in (z, z + SIGMA * anchor, 1 / SIGMA)))
        got = log_mean(jitted[function](*ends, sensor))
        a, b, z, anchor = (np.float64(x) for x in (*ends, *sensor[:2]))
    want = reference.segment_mean(z, a, b, SIGMA) - reference.segment_mean(z, anchor, anchor, SIGMA)
    # Rounding is relative to the squares of the distances that are subtracted.
    squares = 1 + (max(abs(a - z), abs(b - z)) / SIGMA) ** 2 + ((anchor - z) / SIGMA) ** 2
    assert abs(got - want) <= TOLERANCE[precision] + 4 * np.finfo(precision).eps * squares


@both_precisions
@given(start=distances, share=st.floats(-1, 1), z=st.floats(-3, 3), near=st.floats(-1, 1))
def test_the_mean_along_a_short_segment_is_the_integral(precision, start, share, z, near):
    length = share * LONG[np.dtype(precision)]
    agree(short_mean, precision, start, length, z, start + near)


@both_precisions
@given(
    start=distances,
    length=st.floats(1, 60),
    sign=st.sampled_from([-1, 1]),
    z=st.floats(-3, 3),
    near=st.floats(-1, 1),
)
def test_the_mean_along_a_long_segment_is_the_integral(precision, start, length, sign, z, near):
    shortest = LONG[np.dtype(precision)]
    agree(long_mean, precision, start, sign * length * shortest, z, start + near)


@both_precisions
@given(st.lists(st.floats(-200, 200), min_size=2, max_size=2), st.floats(1e-3, 1))
def test_two_means_average(precision, peaks, factor):
    with x64(precision):
        left, right = (
            Mean(jnp.asarray(p, precision), jnp.asarray(factor, precision)) for p in peaks
        )
        got = log_mean(jitted[mean_of_two](left, right))
        want = np.logaddexp(*(log_mean(mean) for mean in (left, right))) + np.log(0.5)
    assert got == pytest.approx(want, abs=1e3 * float(np.finfo(precision).eps))


@both_precisions
@given(st.floats(0, 80))
def test_exponentials_are_exact_to_the_working_precision(precision, x):
    with x64(precision):
        x = jnp.asarray(x, precision)
        minus, scaled = jitted[exp_minus](x), jitted[exp](-100 * x)
        want = np.exp(-np.float64(x))
        log = np.log(np.float64(scaled.mantissa)) + int(scaled.exponent) * np.log(2)
    eps = float(np.finfo(precision).eps)
    assert float(minus) == pytest.approx(want, rel=eps * (4 + 2 * float(x)))
    assert log == pytest.approx(-100 * float(x), abs=eps * (4 + 200 * float(x)))


def test_quotients_fit_functions_over_many_decades():
    functions = [lambda w: (2 + w) / (1 + w) / (3 + w), lambda w: 1 / (1 + w) / (3 + w)]
    numerators, divisor = fit_quotients(functions, 2, 1e6)
    w = np.concatenate([[0], np.logspace(-3, 6, 200)])
    for numerator, function in zip(numerators, functions, strict=True):
        got = np.polyval(numerator, w) / np.polyval(divisor, w)
        np.testing.assert_allclose(got, function(w), rtol=1e-9)


@given(
    lengths=st.lists(st.integers(1, 9), min_size=1, max_size=4),
    n_sensors=st.integers(1, 3),
    seed=st.integers(0, 99),
)
def test_the_list_has_every_segment_once_the_longest_first(lengths, n_sensors, seed):
    rng = np.random.default_rng(seed)
    rows = [rng.integers(0, 4, (n, n_sensors)) for n in lengths]
    records = Records.from_sequences(rows, [np.zeros((n, 1)) for n in lengths])
    nodes, long = np.asarray(records.nodes), LongestFirst(*map(np.asarray, records.long))
    n_segments = len(rows) * (records.longest + 1)
    assert long.record.shape[1] % CHUNK == 0
    for k in range(n_sensors):
        record, place, ends = long.record[k], long.place[k], long.ends[:, k]
        i, at = record[:n_segments], place[:n_segments]
        assert len(set(zip(i, at, strict=True))) == n_segments
        for end in (0, 1):
            np.testing.assert_array_equal(ends[end, :n_segments], nodes[k, i, at + end])
        assert not ends[:, n_segments:].any()
        apart = np.where(place <= np.array(lengths)[record], np.abs(np.diff(ends, axis=0)[0]), 0)
        np.testing.assert_array_equal(apart, np.sort(apart)[::-1])
        np.testing.assert_allclose(long.longest[k], apart[::CHUNK], rtol=1e-6)


@pytest.mark.parametrize("start", [None, [0, 30, 200]])
def test_long_segments_from_the_list_agree_with_all_computed_exactly(monkeypatch, start):
    rng = np.random.default_rng(0)
    steps = 0.02 * rng.normal(size=(3, 400, 9)) * np.where(rng.random((3, 400, 1)) < 0.1, 20, 1)
    records = Records.from_sequences(list(steps.cumsum(axis=1)), [np.zeros((400, 1))] * 3)
    params = Params(0.1, 0.05, jnp.linspace(0.05, 0.2, 9))
    if start is not None:
        belief = build_filter("own_tau", 96).init(records)
        records = view(records, replace(belief, start=jnp.array(start, jnp.int32)))
    anchor = records.nodes[:, 1, 50]
    logs = []
    for relative_cost in (0, 10**6):
        monkeypatch.setattr(long_segments, "_LISTED", relative_cost)
        logs.append(np.asarray(likelihood(records, params, anchor + 0.05, anchor)))
    np.testing.assert_allclose(*logs, rtol=1e-6, atol=1e-5)
    monkeypatch.setattr(long_segments, "_is_long", lambda length: length > np.inf)
    without = np.asarray(likelihood(records, params, anchor + 0.05, anchor))
    assert np.abs(without - logs[0]).max() > 1e-3
