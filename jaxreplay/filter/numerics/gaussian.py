"""Means of a Gaussian along segments, relative to its density at an anchor.

A segment's mean is the difference of the two tails beyond its ends, divided by its length. A tail
is the density at the end times Mills' ratio, and a density relative to the anchor is a power of two
whose exponent, a difference of two squares, is computed with its rounding error. Short segments,
whose tails would cancel, use the Euler–Maclaurin formula instead.

Everything is in units of a power of two near σ, so that squares of distances stay in range.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import erfcx

from jaxreplay.filter.numerics.compensated import TwoFloats, two_product, two_quotient, two_sum
from jaxreplay.filter.numerics.polynomial import evaluate, fit
from jaxreplay.filter.numerics.scaled import LOWEST, Scaled, exp2, scaled
from jaxreplay.filter.numerics.stage import stage

HALF_LOG2_E = float(1 / (2 * np.log(2)))  # exp(−x²/2) = 2^(−HALF_LOG2_E x²)
# Largest value, in σ (within a factor of 2) from the sensor's offset; larger ones are clipped.
FARTHEST = 2.0**50
_SQRT_2PI = np.sqrt(2 * np.pi)

# (x + c) · Mills(x) is approximated by a polynomial in (x − c) / (x + c), after Shepherd &
# Laframboise, Math. Comp. 36 (1981): one division, no exponential. Relative error 5e-8 (float32),
# 6e-15 (float64).
_MILLS_CENTRE = 4.0
_MILLS_DEGREE = {np.dtype(np.float32): 10, np.dtype(np.float64): 20}
# A segment on which length/σ × max(1, distance of the farther end from z, /σ) is below this is
# short: its tails would cancel.
_SHORT = {np.dtype(np.float32): 0.3, np.dtype(np.float64): 0.01}


def _smooth_mills(y: np.ndarray) -> np.ndarray:
    x = _MILLS_CENTRE * (1 + y) / (1 - y)
    return (x + _MILLS_CENTRE) * np.sqrt(np.pi / 2) * erfcx(x / np.sqrt(2))


_MILLS = {dtype: fit(_smooth_mills, degree) for dtype, degree in _MILLS_DEGREE.items()}


class SensorTerms(NamedTuple):
    """What is the same for all samples of a sensor, each `[n_s, 1]`.

    z, anchor, σ and all that follows from them are in units of 2^⌊log2 σ⌋.

    Attributes:
        unit: 2^−⌊log2 σ⌋, the factor from the sensor's unit to that unit.
        z: the observation.
        inverse: 1 / σ.
        anchor: the anchor.
        twice_anchor_minus_z: 2 (anchor − z), as two floats.
        factor: 1 / (2 σ² ln 2), as two floats.
        peak: N(z; z, σ²) / N(z; anchor, σ²).
    """

    unit: jax.Array
    z: jax.Array
    inverse: jax.Array
    anchor: jax.Array
    twice_anchor_minus_z: TwoFloats
    factor: TwoFloats
    peak: Scaled


class Nodes(NamedTuple):
    """What each of n samples contributes to the two segments that meet in it, each `[n_s, n]`.

    Attributes:
        zeta: the samples ζ, in units of 2^⌊log2 σ⌋.
        density: N(z; ζ, σ²) / N(z; anchor, σ²), mantissa not in [1, 2).
        mills: Mills' ratio of |ζ − z| / σ: the tail beyond ζ, divided by the density at ζ.
    """

    zeta: jax.Array
    density: Scaled
    mills: jax.Array


def mills_ratio(x: jax.Array) -> jax.Array:
    """Return (1 − Φ(x)) / φ(x) of the standard normal distribution, for x ≥ 0 of any shape."""
    w = 1 / (x + _MILLS_CENTRE)
    return evaluate(_MILLS[x.dtype], 1 - 2 * _MILLS_CENTRE * w) * w


def sensor_terms(sigma: jax.Array, z: jax.Array, anchor: jax.Array) -> SensorTerms:
    """Compute what all samples of a sensor share, from σ, z and the anchor.

    Each is `[n_s]`, in the sensors' units; z and the anchor are centred, without NaN.
    """
    return _sensor_terms(sigma[:, None], z[:, None], anchor[:, None])


def segment_mean(nodes: jax.Array, terms: SensorTerms) -> Scaled:
    """Compute the mean of N(z; ·, σ²) / N(z; anchor, σ²) along each segment.

    Args:
        nodes: `[n_s, n]` samples ζ, centred, in the sensors' units.
        terms: what :func:`sensor_terms` returns for the observation.

    Returns:
        `[n_s, n − 1]`, one for each segment between neighbours; mantissas within 2^±12.
    """
    zeta = jnp.clip(nodes * terms.unit, -FARTHEST, FARTHEST)
    exponent = stage(_near_log2_ratio)(zeta, terms)
    ends = Nodes(zeta, Scaled(_density(zeta, terms, exponent), exponent), _mills(zeta, terms))
    exponent = _mean_exponent(ends, terms)
    return Scaled(_mean(ends, terms, exponent), exponent)


@stage
def _sensor_terms(sigma: jax.Array, z: jax.Array, anchor: jax.Array) -> SensorTerms:
    power = scaled(sigma)
    unit = Scaled(jnp.ones_like(z), -power.exponent).value()
    z, anchor = (jnp.clip(x * unit, -FARTHEST, FARTHEST) for x in (z, anchor))
    apart, apart_low = two_sum(anchor, -z)
    factor = two_quotient(HALF_LOG2_E, two_product(power.mantissa, power.mantissa))
    nothing = Scaled(jnp.zeros_like(z), power.exponent)
    terms = SensorTerms(
        unit, z, 1 / power.mantissa, anchor, (2 * apart, 2 * apart_low), factor, nothing
    )
    near = _near_log2_ratio(z, terms)
    return terms._replace(peak=Scaled(exp2(*_log2_ratio(z, terms), near), near))


@stage
def _density(zeta: jax.Array, terms: SensorTerms, exponent: jax.Array) -> jax.Array:
    return exp2(*_log2_ratio(zeta, terms), exponent)


@stage
def _mills(zeta: jax.Array, terms: SensorTerms) -> jax.Array:
    return mills_ratio(jnp.abs((zeta - terms.z) * terms.inverse))


@stage
def _mean_exponent(nodes: Nodes, terms: SensorTerms) -> jax.Array:
    """Return an integer near log2 of each mean.

    It is that of the highest density on the segment, minus log2 of length × distance (in σ) where
    that exceeds 1.
    """
    start, end, between = _ends(nodes, terms)
    distance = jnp.minimum(jnp.abs(start.zeta - terms.z), jnp.abs(end.zeta - terms.z))
    distance = jnp.where(between, 0.0, distance) * terms.inverse
    d = jnp.abs(end.zeta - start.zeta) * terms.inverse
    spread = scaled(jnp.maximum(d * jnp.maximum(distance, 1.0), 1.0)).exponent
    exponent = jnp.maximum(start.density.exponent, end.density.exponent)
    return jnp.where(between, terms.peak.exponent, exponent) - spread


@stage
def _mean(nodes: Nodes, terms: SensorTerms, exponent: jax.Array) -> jax.Array:
    start, end, between = _ends(nodes, terms)
    a, b = start.density.at(exponent), end.density.at(exponent)

    # The integral over x = (ζ − z) / σ, in units of 2^exponent: the whole bell less both tails
    # where z lies between the ends, else one tail less the other.
    tail_a, tail_b = a * start.mills, b * end.mills
    across = _SQRT_2PI * terms.peak.at(exponent) - tail_a - tail_b
    integral = jnp.where(between, across, jnp.abs(tail_a - tail_b))

    # On a short segment the tails cancel. The Euler–Maclaurin sum over its ends, with the first and
    # third derivative of the Gaussian, is exact there to the working precision.
    x_start, x_end = ((node.zeta - terms.z) * terms.inverse for node in (start, end))
    d = (end.zeta - start.zeta) * terms.inverse
    reach = jnp.maximum(jnp.maximum(jnp.abs(x_start), jnp.abs(x_end)), 1.0)
    short = jnp.abs(d) * reach < _SHORT[d.dtype]
    d_short = jnp.where(short, d, 0.0)
    da, db = d_short * x_start, d_short * x_end
    d2 = d_short * d_short
    mean = (a + b) / 2 + (db * b - da * a) / 12
    mean -= (db * (db * db - 3 * d2) * b - da * (da * da - 3 * d2) * a) / 720
    mean = jnp.where(short, mean, integral / jnp.where(short, 1.0, jnp.abs(d)))
    return jnp.maximum(mean, 2.0**-12)


def _ends(nodes: Nodes, terms: SensorTerms) -> tuple[Nodes, Nodes, jax.Array]:
    """Return where segments start and end, and whether z lies between."""
    start = jax.tree.map(lambda node: node[:, :-1], nodes)
    end = jax.tree.map(lambda node: node[:, 1:], nodes)
    return start, end, (start.zeta < terms.z) != (end.zeta < terms.z)


def _near_log2_ratio(point: jax.Array, terms: SensorTerms) -> jax.Array:
    """Return an integer near log2 of N(z; point, σ²) / N(z; anchor, σ²).

    It is clipped to where an exponent can still represent the product over all sensors.
    """
    apart = terms.anchor - point
    ratio = apart * (terms.twice_anchor_minus_z[0] - apart) * terms.factor[0]
    lowest = LOWEST // point.shape[0]
    return jnp.clip(jnp.round(jax.lax.stop_gradient(ratio)), lowest, -lowest).astype(jnp.int32)


def _log2_ratio(point: jax.Array, terms: SensorTerms) -> TwoFloats:
    """Return log2 of N(z; point, σ²) / N(z; anchor, σ²) as two floats.

        (anchor − point) · (point + anchor − 2 z) / (2 σ² ln 2)

    Rounded to one float, tens of σ away from all records its error would show in the posterior.
    """
    apart, apart_low = two_sum(terms.anchor, -point)
    total, total_low = two_sum(terms.twice_anchor_minus_z[0], -apart)
    total_low += terms.twice_anchor_minus_z[1] - apart_low
    product, product_low = two_product(apart, total)
    product_low += apart * total_low + apart_low * total
    high, low = two_product(product, terms.factor[0])
    return high, low + (product * terms.factor[1] + product_low * terms.factor[0])
