"""The observation model (§ 2.2.2): a Gaussian convolved with the segments of a record.

Densities are relative to that of an *anchor*, a point of the records near the observation: what
decides between two hypotheses is their ratio, and far from every record (hundreds of σ) the
difference of their logarithms is smaller than the rounding of either.
"""

from collections.abc import Callable
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import chebyshev
from scipy.special import erfcx

from jaxreplay.records import Records
from jaxreplay.scaled import LOWEST, Scaled, exp2, product, scaled, upper_half
from jaxreplay.stage import stage

SQRT_2PI = np.sqrt(2 * np.pi)
_HALF_LOG2_E = float(1 / (2 * np.log(2)))
_FARTHEST = 2.0**50  # σ, or half as many; what is farther is taken to be there

# States computed at once. A step then needs a few MB on the way, not tens of them, which the C
# library would give back to the system each time: new pages took most of a step's time.
BLOCK = 2**15

# Mills' ratio times x + c as a polynomial in (x − c) / (x + c), after Shepherd & Laframboise,
# Math. Comp. 36 (1981): one division and no exponential, relative error 5e-8 (degree 10), 6e-15
# (20).
_MILLS_CENTRE = 4.0
_MILLS_DEGREE = {np.dtype(np.float32): 10, np.dtype(np.float64): 20}
# Below this length × distance, in σ, a segment's two tails cancel: a sum over its ends takes over.
_SHORT = {np.dtype(np.float32): 0.3, np.dtype(np.float64): 0.01}


def _mills_coefficients(degree: int) -> np.ndarray:
    def smooth(y):
        x = _MILLS_CENTRE * (1 + y) / (1 - y)
        return (x + _MILLS_CENTRE) * np.sqrt(np.pi / 2) * erfcx(x / np.sqrt(2))

    return chebyshev.cheb2poly(chebyshev.chebinterpolate(smooth, degree))[::-1]


_MILLS = {dtype: _mills_coefficients(degree) for dtype, degree in _MILLS_DEGREE.items()}


def mills_ratio(x: jax.Array) -> jax.Array:
    """(1 − Φ(x)) / φ(x) of the standard normal, for x ≥ 0, any shape."""
    w = 1 / (x + _MILLS_CENTRE)
    y = 1 - 2 * _MILLS_CENTRE * w
    value = jnp.zeros_like(x)
    for coefficient in _MILLS[x.dtype]:
        value = value * y + float(coefficient)
    return value * w


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
        anchor: `[n_s]` any point, best the one :func:`anchor_point` gives.

    Returns:
        `[N, L]` p(Z_t | i, j) / p(Z_t | anchor), the anchor a point Gaussian (see
        :func:`log_density`). Values past a record's end mean nothing.
    """
    z, seen = _seen(records, z)
    frame = _frame(*(value[:, None] for value in (sigma, z, anchor)))

    def states_of(nodes):
        zeta = _in_unit(nodes, frame)
        return _states(_segments(_nodes(zeta, frame), frame), seen[:, None])

    states = _in_blocks(states_of, records.nodes.reshape(records.n_sensors, -1))
    return jax.tree.map(lambda x: x.reshape(records.n_records, -1)[:, :-2], states)


def _in_blocks(states_of: Callable, nodes: jax.Array) -> Scaled:
    """The states of all nodes `[n_s, n]`, computed for one block of them after the other."""
    n_states = nodes.shape[1] - 2
    n_blocks = -(-n_states // BLOCK)
    if n_blocks == 1:
        return states_of(nodes)
    size = -(-n_states // n_blocks)

    def fill(k, states):
        start = jnp.minimum(k * size, n_states - size)  # the last block overlaps another
        block = states_of(jax.lax.dynamic_slice_in_dim(nodes, start, size + 2, axis=1))
        put = partial(jax.lax.dynamic_update_slice_in_dim, start_index=start, axis=0)
        return jax.tree.map(put, states, block)

    shapes = jax.eval_shape(states_of, nodes)
    states = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return jax.lax.fori_loop(0, n_blocks, fill, states)


def anchor_point(records: Records, sigma: jax.Array, z: jax.Array, prior: Scaled) -> jax.Array:
    """A point `[n_s]` to anchor :func:`likelihood` at.

    The observation itself does, brought within what the records span, as long as all densities
    fit an exponent relative to it. Further away, thousands of σ, it is the point closest to z,
    in σ, of the segments of the state that equation 9 is about to favour, `prior` being the
    predicted belief, `[N, L]`.
    """
    z, seen = _seen(records, z)
    low, high = records.span
    point = jnp.clip(z, low, high)
    reach, beyond = (jnp.minimum(x / sigma, _FARTHEST) for x in (high - low, jnp.abs(z - point)))
    bits = _HALF_LOG2_E * jnp.where(seen, reach * (reach + 2 * beyond), 0.0)
    near = jnp.max(bits) < -LOWEST // records.n_sensors
    return jax.lax.cond(near, lambda *_: point, _nearest_point, records, sigma, z, seen, prior)


def _nearest_point(records: Records, sigma, z, seen, prior: Scaled) -> jax.Array:
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
    farthest = jnp.sqrt(jnp.finfo(z.dtype).max) / len(z)  # so that the sum stays finite
    distance = jnp.clip((jnp.where(seen, z, point) - point) / sigma, -farthest, farthest)
    return jnp.sum(jnp.where(seen, -(distance**2) / 2 - jnp.log(sigma * SQRT_2PI), 0.0))


def _seen(records: Records, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The observation with something finite for missing sensors, and which are not missing."""
    seen = ~jnp.isnan(z)
    return jnp.where(seen, z, records.nodes[:, 0, 1]), seen


def _nearest(z, *nodes):
    """The point nearest to z of the polyline through the nodes."""
    return jnp.clip(z, reduce(jnp.minimum, nodes), reduce(jnp.maximum, nodes))


class _Frame(NamedTuple):
    """What is the same for all samples of a sensor, each `[n_s, 1]`.

    Distances are in units of the power of two below σ, so that their squares stay in range.
    """

    unit: jax.Array
    z: jax.Array
    inverse: jax.Array  # 1 / σ
    anchor: jax.Array
    offset: tuple[jax.Array, jax.Array]  # 2 (anchor − z), and what rounding took
    factor: tuple[jax.Array, jax.Array]  # 1 / (2 σ² ln 2), and what rounding took
    peak: Scaled  # N(z; z, σ²) / N(z; anchor, σ²)


class _Nodes(NamedTuple):
    """What samples contribute to the segments between them, each `[n_s, N (L + 2)]`.

    zeta: the samples ζ.
    density: N(z; ζ, σ²) / N(z; anchor, σ²), not normalised.
    mills: Mills' ratio of |ζ − z| / σ, the tail beyond in units of the density there.
    """

    zeta: jax.Array
    density: Scaled
    mills: jax.Array


@stage
def _frame(sigma, z, anchor) -> _Frame:
    sigma = scaled(sigma)
    unit = Scaled(jnp.ones_like(z), -sigma.exponent).value()
    z, anchor = (jnp.clip(x * unit, -_FARTHEST, _FARTHEST) for x in (z, anchor))
    offset, offset_low = _two_sum(anchor, -z)
    factor = _two_quotient(_HALF_LOG2_E, *_two_product(sigma.mantissa, sigma.mantissa))
    frame = _Frame(
        unit, z, 1 / sigma.mantissa, anchor, (2 * offset, 2 * offset_low), factor, peak=None
    )
    near = _near_log2_ratio(z, frame)
    return frame._replace(peak=Scaled(exp2(*_log2_ratio(z, frame), near), near))


def _in_unit(zeta, frame: _Frame):
    return jnp.clip(zeta * frame.unit, -_FARTHEST, _FARTHEST)


def _nodes(zeta, frame: _Frame) -> _Nodes:
    near = stage(_near_log2_ratio)(zeta, frame)
    density = Scaled(_exp2_ratio(zeta, frame, near), near)
    return _Nodes(zeta, density, _tail(zeta, frame))


@stage
def _exp2_ratio(zeta, frame: _Frame, near):
    return exp2(*_log2_ratio(zeta, frame), near)


@stage
def _tail(zeta, frame: _Frame):
    return mills_ratio(jnp.abs((zeta - frame.z) * frame.inverse))


def _segments(nodes: _Nodes, frame: _Frame) -> Scaled:
    """The mean of N(z; ·, σ²) / N(z; anchor, σ²) along each segment, `[n_s, N (L + 2) − 1]`.

    Not normalised, but within 2^±12.
    """
    exponent = _segment_exponent(nodes, frame)
    return Scaled(_segment_mean(nodes, frame, exponent), exponent)


@stage
def _segment_exponent(nodes: _Nodes, frame: _Frame):
    """That of the denser end, less what the mean along the segment is below it."""
    start, end, between = _ends(nodes, frame)
    distance = jnp.minimum(jnp.abs(start.zeta - frame.z), jnp.abs(end.zeta - frame.z))
    distance = jnp.where(between, 0.0, distance) * frame.inverse
    d = jnp.abs(end.zeta - start.zeta) * frame.inverse
    spread = scaled(jnp.maximum(d * jnp.maximum(distance, 1.0), 1.0)).exponent
    exponent = jnp.maximum(start.density.exponent, end.density.exponent)
    return jnp.where(between, frame.peak.exponent, exponent) - spread


@stage
def _segment_mean(nodes: _Nodes, frame: _Frame, exponent):
    start, end, between = _ends(nodes, frame)
    a, b = start.density.at(exponent), end.density.at(exponent)

    # The integral, in units of the density: two tails, taken from the whole bell if z lies
    # between them, else one from the other.
    tail_a, tail_b = a * start.mills, b * end.mills
    across = SQRT_2PI * frame.peak.at(exponent) - tail_a - tail_b
    integral = jnp.where(between, across, jnp.abs(tail_a - tail_b))

    # On a short segment the tails cancel; there the Euler–Maclaurin sum of its two ends, with
    # the Gaussian's first and third derivatives, is exact to the working precision.
    x_start, x_end = ((node.zeta - frame.z) * frame.inverse for node in (start, end))
    d = (end.zeta - start.zeta) * frame.inverse
    reach = jnp.maximum(jnp.maximum(jnp.abs(x_start), jnp.abs(x_end)), 1.0)
    short = jnp.abs(d) * reach < _SHORT[d.dtype]
    d_short = jnp.where(short, d, 0.0)
    da, db = d_short * x_start, d_short * x_end
    d2 = d_short * d_short
    mean = (a + b) / 2 + (db * b - da * a) / 12
    mean -= (db * (db * db - 3 * d2) * b - da * (da * da - 3 * d2) * a) / 720
    mean = jnp.where(short, mean, integral / jnp.where(short, 1.0, jnp.abs(d)))
    return jnp.maximum(mean, 2.0**-12)


def _ends(nodes: _Nodes, frame: _Frame) -> tuple[_Nodes, _Nodes, jax.Array]:
    """Where segments start and end, and whether z is between."""
    start = jax.tree.map(lambda node: node[:, :-1], nodes)
    end = jax.tree.map(lambda node: node[:, 1:], nodes)
    return start, end, (start.zeta < frame.z) != (end.zeta < frame.z)


@stage
def _states(segments: Scaled, seen) -> Scaled:
    """Half of each of the two segments at every sample, multiplied over sensors.

    `[N (L + 2)]`; the last two of every L + 2 belong to no sample.
    """
    left, right = segments[:, :-1], segments[:, 1:]
    exponent = jnp.maximum(left.exponent, right.exponent)
    both = jnp.where(seen, left.at(exponent) + right.at(exponent), 2.0)
    states = product(Scaled(both, jnp.where(seen, exponent, 0) - 1))
    return jax.tree.map(lambda x: jnp.pad(x, (0, 2)), states)


def _near_log2_ratio(point, frame: _Frame):
    """An integer near log2 of N(z; point, σ²) / N(z; anchor, σ²).

    It stops where an exponent could no longer hold the product over all sensors.
    """
    apart = frame.anchor - point
    ratio = apart * (frame.offset[0] - apart) * frame.factor[0]
    lowest = LOWEST // point.shape[0]
    return jnp.clip(jnp.round(jax.lax.stop_gradient(ratio)), lowest, -lowest).astype(jnp.int32)


def _log2_ratio(point, frame: _Frame):
    """log2 of N(z; point, σ²) / N(z; anchor, σ²), as a sum of two floats not added up.

    It is (anchor − point) (point + anchor − 2 z) / (2 σ² ln 2), each rounding error kept: tens
    of σ away from every record its rounding to one float would be seen in the posterior.
    """
    apart, apart_low = _two_sum(frame.anchor, -point)
    total, total_low = _two_sum(frame.offset[0], -apart)
    total_low += frame.offset[1] - apart_low
    product, product_low = _two_product(apart, total)
    product_low += apart * total_low + apart_low * total
    high, low = _two_product(product, frame.factor[0])
    return high, low + (product * frame.factor[1] + product_low * frame.factor[0])


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
