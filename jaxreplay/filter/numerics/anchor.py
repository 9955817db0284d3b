"""The anchor: the point near an observation that the densities of equation 2 are relative to."""

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter.numerics.scaled import Scaled
from jaxreplay.params import Params
from jaxreplay.records import Records

# Sum of squared distances, in σ, up to which rounding costs a log density less than 1e-5.
_NEAR = 100.0
_FARTHEST = 2.0**20  # σ beyond the records' range, where an observation is clipped
_NARROWEST = 2.0**50  # a σ below 1/this of the records' range counts as that
_SQRT_2PI = np.sqrt(2 * np.pi)


def measured(records: Records, sigma: jax.Array, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return z `[n_s]` without NaN, and 1/σ `[n_s]`, 0 for a missing sensor.

    Both are clipped, so that squares of distances stay in range.
    """
    low, high = records.span
    beyond = _FARTHEST * jax.lax.stop_gradient(sigma)
    missing = jnp.isnan(z)
    z = jnp.clip(jnp.where(missing, low, z), low - beyond, high + beyond)
    width = high - low
    inverse = jnp.minimum(1 / sigma, _NARROWEST / jnp.where(width > 0, width, 1 / _NARROWEST))
    return z, jnp.where(missing, 0.0, inverse)


def log_density(params: Params, z: jax.Array, point: jax.Array) -> jax.Array:
    """Return log N(z; point, σ²), summed over the measured sensors: a scalar, always finite.

    Args:
        params: σ is used.
        z: `[n_s]` the centred observation; NaN for a missing sensor.
        point: `[n_s]` any point, centred, in the sensors' units.
    """
    present = ~jnp.isnan(z)
    farthest = jnp.sqrt(jnp.finfo(z.dtype).max) / len(z)  # so that the sum of squares is finite
    distance = (jnp.where(present, z, point) - point) / params.sigma
    distance = jnp.clip(distance, -farthest, farthest)
    logs = -(distance**2) / 2 - jnp.log(params.sigma * _SQRT_2PI)
    return jnp.sum(jnp.where(present, logs, 0.0))


def anchor_point(records: Records, params: Params, belief: Scaled, z: jax.Array) -> jax.Array:
    """Choose the anchor for an observation: near the state that equation 9 will favour.

    The observation itself, clipped to the records' range, will do while the most probable state is
    within some σ of it: then so is the state that equation 9 will favour. Otherwise the anchor is
    the point nearest to z on the segments of the latter.

    Args:
        records: N records, centred.
        params: σ is used.
        belief: `[N, L]` the predicted belief.
        z: `[n_s]` the centred observation; NaN for a missing sensor.

    Returns:
        `[n_s]` a point, centred, in the sensors' units.
    """
    z, inverse = measured(records, params.sigma, z)
    point = jnp.clip(z, *records.span)
    i, j = highest(belief.exponent)
    apart = (records.nodes[:, i, j + 1] - z) * inverse
    arguments = (records, inverse, z, belief)
    return jax.lax.cond(
        jnp.sum(apart * apart) < _NEAR, lambda *_: point, _nearest_point, *arguments
    )


def _nearest_point(records: Records, inverse: jax.Array, z: jax.Array, belief: Scaled) -> jax.Array:
    """Return the point nearest to z on the segments of the state that equation 9 will favour."""

    def add(k: jax.Array, score: jax.Array) -> jax.Array:
        nodes = records.nodes[k]
        point = _nearest(z[k], nodes[:, :-2], nodes[:, 1:-1], nodes[:, 2:])
        start = records.nodes[k, 0, 1]  # any point: squares of large distances have few digits
        apart, total = (start - point) * inverse[k], (start + point - 2 * z[k]) * inverse[k]
        return score + apart * total / 2

    prior = belief.exponent.astype(z.dtype) * float(np.log(2))
    score = jax.lax.fori_loop(0, records.n_sensors, add, prior)
    i, j = highest(jnp.where(belief.mantissa == 0, -jnp.inf, score))
    nodes = records.nodes
    return _nearest(z, nodes[:, i, j], nodes[:, i, j + 1], nodes[:, i, j + 2])


def highest(values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the row and the column of the first of the highest values."""
    # Not argmax: XLA on CPU fuses it into loops that compute `values` again.
    place = jnp.arange(values.size, dtype=jnp.int32).reshape(values.shape)
    first = jnp.min(jnp.where(values == jnp.max(values), place, values.size - 1))
    row, column = jnp.unravel_index(first, values.shape)
    return row, column


def _nearest(z: jax.Array, *nodes: jax.Array) -> jax.Array:
    """Return the point nearest to z on the polyline through the nodes, for each sensor."""
    return jnp.clip(z, reduce(jnp.minimum, nodes), reduce(jnp.maximum, nodes))
