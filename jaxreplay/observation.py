"""The observation model (§ 2.2.2): a Gaussian convolved with the segments of a record.

Densities are relative to that of an *anchor*, a point of the records near the observation: what
decides between two hypotheses is their ratio, and far from every record (hundreds of σ) the
difference of their logarithms is smaller than the rounding of either.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import chebyshev
from scipy.special import erfcx

from jaxreplay.records import Records
from jaxreplay.scaled import Scaled, exp2, product, scaled, upper_half
from jaxreplay.stage import stage

SQRT_2PI = np.sqrt(2 * np.pi)
_HALF_LOG2_E = float(1 / (2 * np.log(2)))

# Mills' ratio as a polynomial in (x − c) / (x + c), after Shepherd & Laframboise, Math. Comp.
# 36 (1981): one division and no exponential, relative error 5e-8 (degree 10), 6e-15 (20).
_MILLS_CENTRE = 4.0
_MILLS_DEGREE = {np.dtype(np.float32): 10, np.dtype(np.float64): 20}
# Below this length × distance, in σ, a segment's two tails cancel: a sum over its ends takes over.
_SHORT = {np.dtype(np.float32): 0.3, np.dtype(np.float64): 0.01}


def _mills_coefficients(degree: int) -> np.ndarray:
    def smooth(y):
        x = _MILLS_CENTRE * (1 + y) / (1 - y)
        return (1 + x) * np.sqrt(np.pi / 2) * erfcx(x / np.sqrt(2))

    return chebyshev.cheb2poly(chebyshev.chebinterpolate(smooth, degree))[::-1]


_MILLS = {dtype: _mills_coefficients(degree) for dtype, degree in _MILLS_DEGREE.items()}


def mills_ratio(x: jax.Array) -> jax.Array:
    """(1 − Φ(x)) / φ(x) of the standard normal, for x ≥ 0, any shape."""
    y = (x - _MILLS_CENTRE) / (x + _MILLS_CENTRE)
    value = jnp.zeros_like(x)
    for coefficient in _MILLS[x.dtype]:
        value = value * y + float(coefficient)
    return value / (1 + x)


def likelihood(records: Records, sigma: jax.Array, z: jax.Array, anchor: jax.Array) -> Scaled:
    """Equation 2: p(Z_t | I_t = i, τ_t = j) for all i and j, over the density at the anchor.

    A segment's integral divided by its length is the mean of N(z; ζ, σ²) over it; each state
    is half the mean over the segment that ends at it and half over the one that starts at it.

    Open points of the paper, decided: N(t, σ²) is the normal density of Z_t − t; at a
    record's ends the one segment there carries full weight; a segment of no length is the
    point Gaussian, its limit; a record of length 1 is a point. A NaN in z is a sensor that
    gave nothing, and tells no state from another.

    Args:
        records: N records.
        sigma: `[n_s]` σ.
        z: `[n_s]` the observation Z_t, NaN where a sensor is missing.
        anchor: `[n_s]` any point, best the one :func:`nearest_point` gives.

    Returns:
        `[N, L]` p(Z_t | i, j) / p(Z_t | anchor), the anchor a point Gaussian (see
        :func:`log_density`). Values past a record's end mean nothing.
    """
    z, seen = _seen(records, z)
    sigma, z, anchor, seen = (value[:, None, None] for value in (sigma, z, anchor, seen))
    nodes = _nodes(records.nodes, sigma, z, anchor)
    segments = _segments(nodes, sigma, z, _density_ratio(z, sigma, z, anchor))
    return _states(segments, seen)


def nearest_point(records: Records, sigma: jax.Array, z: jax.Array, prior: Scaled) -> jax.Array:
    """A point `[n_s]` of the records to anchor :func:`likelihood` at.

    It is the point closest to z, in σ, of the segments of the state that equation 9 is about
    to favour, `prior` being the predicted belief, `[N, L]`.
    """
    z, seen = _seen(records, z)
    some, unit = records.nodes[:, 0, 1], jnp.sqrt(_HALF_LOG2_E) / sigma
    score = jnp.where(prior.mantissa == 0, -jnp.inf, prior.exponent.astype(z.dtype))
    for k in range(records.n_sensors):
        nodes = records.nodes[k]
        point = _nearest(z[k], nodes[:, :-2], nodes[:, 1:-1], nodes[:, 2:])
        # One float is enough to choose by, as _log2_ratio's two are not for the likelihood.
        apart, total = some[k] - point, (some[k] - z[k]) + (point - z[k])
        score += jnp.where(seen[k], (apart * unit[k]) * (total * unit[k]), 0.0)
    # Not argmax: XLA on CPU fuses that into loops that do all of the above again.
    place = jnp.arange(score.size, dtype=jnp.int32).reshape(score.shape)
    best = jnp.min(jnp.where(score == jnp.max(score), place, score.size - 1))
    i, j = jnp.unravel_index(best, score.shape)
    nodes = records.nodes
    return _nearest(z, nodes[:, i, j], nodes[:, i, j + 1], nodes[:, i, j + 2])


def log_density(z: jax.Array, point: jax.Array, sigma: jax.Array) -> jax.Array:
    """Log of the point Gaussian N(z; point, σ²), summed over the sensors that are not missing."""
    seen = ~jnp.isnan(z)
    distance = (jnp.where(seen, z, point) - point) / sigma
    return jnp.sum(jnp.where(seen, -(distance**2) / 2 - jnp.log(sigma * SQRT_2PI), 0.0))


def _seen(records: Records, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The observation with something finite for missing sensors, and which are not missing."""
    seen = ~jnp.isnan(z)
    return jnp.where(seen, z, records.nodes[:, 0, 1]), seen


def _nearest(z, *nodes):
    """The point nearest to z of the polyline through the nodes."""
    return jnp.clip(z, reduce(jnp.minimum, nodes), reduce(jnp.maximum, nodes))


class _Nodes(NamedTuple):
    """What samples contribute to the segments between them, each `[n_s, N, L + 2]`.

    zeta: the samples ζ, in the sensor's unit.
    density: N(z; ζ, σ²) / N(z; anchor, σ²).
    mills: Mills' ratio of |ζ − z| / σ, the tail beyond in units of the density there.
    """

    zeta: jax.Array
    density: Scaled
    mills: jax.Array


@stage
def _nodes(zeta, sigma, z, anchor) -> _Nodes:
    density = _density_ratio(zeta, sigma, z, anchor)
    return _Nodes(zeta, density, mills_ratio(jnp.abs((zeta - z) * (1 / sigma))))


@stage
def _segments(nodes: _Nodes, sigma, z, peak: Scaled) -> Scaled:
    """The mean of N(z; ·, σ²) / N(z; anchor, σ²) along each segment, `[n_s, N, L + 1]`.

    `peak` is that ratio at z itself. The result is not normalised.
    """
    start, end = (
        jax.tree.map(lambda node, part=part: node[..., part], nodes)
        for part in (slice(None, -1), slice(1, None))
    )
    x_start, x_end = ((node.zeta - z) * (1 / sigma) for node in (start, end))
    between = (start.zeta < z) != (end.zeta < z)
    exponent = jnp.maximum(start.density.exponent, end.density.exponent)
    exponent = jnp.where(between, peak.exponent, exponent)
    a, b = start.density.at(exponent), end.density.at(exponent)

    # The integral, in units of the density: two tails, taken from the whole bell if z lies
    # between them, else one from the other.
    tail_a, tail_b = a * start.mills, b * end.mills
    across = SQRT_2PI * peak.at(exponent) - tail_a - tail_b
    integral = jnp.where(between, across, jnp.abs(tail_a - tail_b))

    # On a short segment the tails cancel; there the Euler–Maclaurin sum of its two ends, with
    # the Gaussian's first and third derivatives, is exact to the working precision.
    d = (end.zeta - start.zeta) * (1 / sigma)
    reach = jnp.maximum(jnp.maximum(jnp.abs(x_start), jnp.abs(x_end)), 1.0)
    short = jnp.abs(d) * reach < _SHORT[d.dtype]
    d_short = jnp.where(short, d, 0.0)
    da, db = d_short * x_start, d_short * x_end
    d2 = d_short * d_short
    mean = (a + b) / 2 + (db * b - da * a) / 12
    mean -= (db * (db * db - 3 * d2) * b - da * (da * da - 3 * d2) * a) / 720
    mean = jnp.where(short, mean, integral / jnp.where(short, 1.0, jnp.abs(d)))
    return Scaled(jnp.maximum(mean, jnp.finfo(mean.dtype).tiny), exponent)


@stage
def _states(segments: Scaled, seen) -> Scaled:
    """Half of each of the two segments at every sample, multiplied over sensors: `[N, L]`."""
    left, right = segments[..., :-1], segments[..., 1:]
    exponent = jnp.maximum(left.exponent, right.exponent)
    both = jnp.where(seen, left.at(exponent) + right.at(exponent), 2.0)
    return product(scaled(both, jnp.where(seen, exponent, 0) - 1))


def _density_ratio(point, sigma, z, anchor) -> Scaled:
    """N(z; point, σ²) / N(z; anchor, σ²)."""
    return exp2(*_log2_ratio(point, z, anchor, sigma))


def _log2_ratio(point, z, anchor, sigma):
    """log2 of N(z; point, σ²) / N(z; anchor, σ²), as a sum of two floats not added up.

    It is (anchor − point) (point + anchor − 2 z) / (2 σ² ln 2), each rounding error kept: tens
    of σ away from every record its rounding to one float would be seen in the posterior.
    """
    unit = scaled(sigma)  # distances in σ's power of two, so that squares stay in range
    to_unit = Scaled(jnp.ones_like(sigma), -unit.exponent).value()
    apart, apart_low = _two_sum(anchor, -point)
    offset, offset_low = _two_sum(anchor, -z)
    total, total_low = _two_sum(2 * offset, -apart)
    total_low += 2 * offset_low - apart_low
    apart, apart_low, total, total_low = (x * to_unit for x in (apart, apart_low, total, total_low))
    product, product_low = _two_product(apart, total)
    product_low += apart * total_low + apart_low * total

    square, square_low = _two_product(unit.mantissa, unit.mantissa)
    factor, factor_low = _two_quotient(_HALF_LOG2_E, square, square_low)
    high, low = _two_product(product, factor)
    return high, low + (product * factor_low + product_low * factor)


def _two_quotient(dividend: float, divisor, divisor_low):
    """The rounded quotient, and what rounding took."""
    top = jnp.asarray(dividend, divisor.dtype)
    top_low = float(dividend - np.asarray(dividend, divisor.dtype).astype(np.float64))
    quotient = top / divisor
    back, back_low = _two_product(quotient, divisor)
    remainder = ((top - back) - back_low) + (top_low - quotient * divisor_low)
    return quotient, remainder / divisor


def _two_sum(a, b):
    """The rounded sum, and what rounding took (Knuth)."""
    s = a + b
    b_seen = s - a
    return s, (a - (s - b_seen)) + (b - b_seen)


def _two_product(a, b):
    """The rounded product, and what rounding took (Dekker)."""
    a_high, b_high = upper_half(a), upper_half(b)
    a_low, b_low = a - a_high, b - b_high
    p = a * b
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low
