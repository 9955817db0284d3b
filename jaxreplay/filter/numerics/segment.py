"""Means of a Gaussian along one segment, and over the two segments that meet in a state.

Every mean is returned as a *peak*, the logarithm of the highest density on the segment relative to
the density at an anchor, and a *factor* in (0, 1] by which the mean is below it. So nothing
underflows however far the observation is, and short segments need no logarithm for a single sensor.

With length d and ends at distances x_a, x_b from z, all in σ, and w = |x_b² − x_a²| / 2, the factor
of a segment on which z does not lie is

    ∫₀¹ exp(−w r + d²/2 · r (1 − r)) dr = Σ_k (d²/2)^k / k! · s_k(w),
    s_k(w) = ∫₀¹ (r (1 − r))^k exp(−w r) dr

A short segment needs the first three s_k, quotients of polynomials with one denominator. There z
may also lie on the segment. The factor of a long one is a difference of two tails.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import beta, erfcx, hyp1f1

from jaxreplay.filter.numerics.polynomial import evaluate, fit, fit_quotients
from jaxreplay.filter.numerics.scaled import exp_minus

_FLOAT32, _FLOAT64 = np.dtype(np.float32), np.dtype(np.float64)
# A segment longer than this, in σ, is long. The series' error is 1e-6 (float32), 1e-14 (float64).
LONG = {_FLOAT32: 0.6, _FLOAT64: 0.003}
# Degree of the quotients, and the largest w for which they are fitted: relative error 2e-7, 1e-14.
# Short segments exceed the latter only thousands of σ away.
_QUOTIENTS = {
    dtype: fit_quotients(
        [lambda w, k=k: beta(k + 1, k + 1) * hyp1f1(k + 1, 2 * k + 2, -w) for k in range(3)], *size
    )
    for dtype, size in ((_FLOAT32, (7, 1e7)), (_FLOAT64, (8, 8.0)))
}
_FARTHEST = 2e4  # of w: keeps the quotients' powers and products of eight factors in range
_S3_PER_S2 = 1 / 28  # the term of k = 3 per term of k = 2 and d², at w = 0, where it matters
_SQRT_2PI = np.sqrt(2 * np.pi)

# (x + c) · Mills(x) is approximated by a polynomial in (x − c) / (x + c), after Shepherd &
# Laframboise, Math. Comp. 36 (1981): one division, no exponential. Relative error 5e-8 (float32),
# 6e-15 (float64).
_MILLS_CENTRE = 4.0
_MILLS_DEGREE = {_FLOAT32: 10, _FLOAT64: 20}


def _smooth_mills(y: np.ndarray) -> np.ndarray:
    x = _MILLS_CENTRE * (1 + y) / (1 - y)
    return (x + _MILLS_CENTRE) * np.sqrt(np.pi / 2) * erfcx(x / np.sqrt(2))


_MILLS = {dtype: fit(_smooth_mills, degree) for dtype, degree in _MILLS_DEGREE.items()}


class Sensor(NamedTuple):
    """What all segments of a sensor share; arrays that broadcast against those of segments.

    Attributes:
        z: the centred observation.
        anchor: the centred anchor.
        inverse: 1 / σ; 0 for a missing sensor, all of whose means are then 1.
    """

    z: jax.Array
    anchor: jax.Array
    inverse: jax.Array


class Mean(NamedTuple):
    """A mean relative to the density at the anchor: exp(peak) · factor."""

    peak: jax.Array
    factor: jax.Array


def log_ratio(point: jax.Array, sensor: Sensor) -> jax.Array:
    """Return log N(z; point, σ²) − log N(z; anchor, σ²), accurate near the anchor.

    (anchor − point) · (point + anchor − 2 z) / (2 σ²)
    """
    apart = (sensor.anchor - point) * sensor.inverse
    return apart * ((point + (sensor.anchor - 2 * sensor.z)) * (sensor.inverse / 2))


def length(start: jax.Array, end: jax.Array, sensor: Sensor) -> jax.Array:
    """Return the lengths of segments in σ."""
    return jnp.abs(end - start) * sensor.inverse


def short_mean(start: jax.Array, end: jax.Array, sensor: Sensor) -> Mean:
    """Return the means along segments of at most `LONG`; those along longer ones are wrong."""
    a, b = log_ratio(start, sensor), log_ratio(end, sensor)
    d = length(start, end, sensor)
    w, d2 = jnp.minimum(jnp.abs(a - b), _FARTHEST), d * d
    (s0, s1, s2), divisor = _QUOTIENTS[w.dtype]
    series = evaluate(s1 / 2, w) + d2 * (1 + _S3_PER_S2 * d2) * evaluate(s2 / 8, w)
    return Mean(jnp.maximum(a, b), (evaluate(s0, w) + d2 * series) / evaluate(divisor, w))


def long_mean(start: jax.Array, end: jax.Array, sensor: Sensor) -> Mean:
    """Return the means along segments longer than `LONG`; those of shorter ones lose digits.

    The tail beyond an end is its density times Mills' ratio. The mean is the whole bell less both
    tails where z lies on the segment, else one tail less the other, divided by the length. It is
    returned in the peak: the factor would be 1 / length, and a product of such underflows.
    """
    low, high = jnp.minimum(start, end), jnp.maximum(start, end)
    nearest = jnp.clip(sensor.z, low, high)
    x_nearest = jnp.abs(nearest - sensor.z) * sensor.inverse

    def tail(point: jax.Array) -> jax.Array:
        # (x² − x_nearest²) / 2 as a product, which cannot be negative however large the squares
        x = jnp.abs(point - sensor.z) * sensor.inverse
        drop = jnp.abs(point - nearest) * sensor.inverse * ((x + x_nearest) / 2)
        return exp_minus(drop) * mills_ratio(x)

    tail_low, tail_high = tail(low), tail(high)
    between = (low < sensor.z) & (sensor.z < high)
    across = _SQRT_2PI - (tail_low + tail_high)
    integral = jnp.where(between, across, jnp.abs(tail_low - tail_high))
    d = length(start, end, sensor)
    mean = jnp.where(d > 0, integral / jnp.where(d > 0, d, 1.0), 1.0)
    return Mean(log_ratio(nearest, sensor) + jnp.log(mean), jnp.ones_like(mean))


def mean_of_two(left: Mean, right: Mean) -> Mean:
    """Return the average of two means."""
    apart = left.peak - right.peak
    higher = jnp.where(apart > 0, left.factor, right.factor)
    lower = jnp.where(apart > 0, right.factor, left.factor)
    factor = (higher + lower * exp_minus(jnp.abs(apart))) / 2
    return Mean(jnp.maximum(left.peak, right.peak), factor)


def mills_ratio(x: jax.Array) -> jax.Array:
    """Return (1 − Φ(x)) / φ(x) of the standard normal distribution, for x ≥ 0 of any shape."""
    w = 1 / (x + _MILLS_CENTRE)
    return evaluate(_MILLS[x.dtype], 1 - 2 * _MILLS_CENTRE * w) * w
