"""The anchor: the point near an observation that the densities of equation 2 are relative to."""

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter.numerics.gaussian import FARTHEST, HALF_LOG2_E
from jaxreplay.filter.numerics.scaled import LOWEST, Scaled
from jaxreplay.params import Params
from jaxreplay.records import Records

_SQRT_2PI = np.sqrt(2 * np.pi)


def measured_only(records: Records, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return z `[n_s]` with a finite value in place of each NaN, and which were measured."""
    measured = ~jnp.isnan(z)
    return jnp.where(measured, z, records.nodes[:, 0, 1]), measured


def log_density(params: Params, z: jax.Array, point: jax.Array) -> jax.Array:
    """Return log N(z; point, σ²), summed over the measured sensors: a scalar, always finite.

    Args:
        params: σ is used.
        z: `[n_s]` the centred observation; NaN for a missing sensor.
        point: `[n_s]` any point, centred, in the sensors' units.
    """
    measured = ~jnp.isnan(z)
    farthest = jnp.sqrt(jnp.finfo(z.dtype).max) / len(z)  # so that the sum of squares is finite
    distance = (jnp.where(measured, z, point) - point) / params.sigma
    distance = jnp.clip(distance, -farthest, farthest)
    logs = -(distance**2) / 2 - jnp.log(params.sigma * _SQRT_2PI)
    return jnp.sum(jnp.where(measured, logs, 0.0))


def anchor_point(records: Records, params: Params, belief: Scaled, z: jax.Array) -> jax.Array:
    """Choose the anchor for an observation.

    It is the observation, clipped to the range of each sensor in the records, as long as log2 of
    every density relative to it exceeds `LOWEST` / n_s. Farther away (millions of σ, for 7 sensors
    whose records span 10 σ) it is the point closest to z on the segments of the state that
    equation 9 will favour.

    Args:
        records: N records, centred.
        params: σ is used.
        belief: `[N, L]` the predicted belief.
        z: `[n_s]` the centred observation; NaN for a missing sensor.

    Returns:
        `[n_s]` a point, centred, in the sensors' units.
    """
    z, measured = measured_only(records, z)
    low, high = records.span
    point = jnp.clip(z, low, high)
    reach, beyond = (
        jnp.minimum(x / params.sigma, FARTHEST) for x in (high - low, jnp.abs(z - point))
    )
    # log2 of the largest ratio of two densities: ((beyond + reach)² − beyond²) / (2 ln 2).
    bits = HALF_LOG2_E * jnp.where(measured, reach * (reach + 2 * beyond), 0.0)
    near = jnp.max(bits) < -LOWEST // records.n_sensors
    arguments = (records, params.sigma, z, measured, belief)
    return jax.lax.cond(near, lambda *_: point, _nearest_point, *arguments)


def _nearest_point(
    records: Records, sigma: jax.Array, z: jax.Array, measured: jax.Array, belief: Scaled
) -> jax.Array:
    """Return the point nearest to z on the segments of the most probable state."""
    some, unit = records.nodes[:, 0, 1], jnp.sqrt(HALF_LOG2_E) / sigma
    score = jnp.where(belief.mantissa == 0, -jnp.inf, belief.exponent.astype(z.dtype))
    for k in range(records.n_sensors):
        nodes = records.nodes[k]
        point = _nearest(z[k], nodes[:, :-2], nodes[:, 1:-1], nodes[:, 2:])
        # One float is accurate enough for this choice; the likelihood itself takes two.
        apart, total = some[k] - point, (some[k] - z[k]) + (point - z[k])
        score += jnp.where(measured[k], (apart * unit[k]) * (total * unit[k]), 0.0)
    # Not argmax: XLA on CPU fuses it into loops that compute all of the above again.
    place = jnp.arange(score.size, dtype=jnp.int32).reshape(score.shape)
    best = jnp.min(jnp.where(score == jnp.max(score), place, score.size - 1))
    i, j = jnp.unravel_index(best, score.shape)
    nodes = records.nodes
    return _nearest(z, nodes[:, i, j], nodes[:, i, j + 1], nodes[:, i, j + 2])


def _nearest(z: jax.Array, *nodes: jax.Array) -> jax.Array:
    """Return the point nearest to z on the polyline through the nodes, for each sensor."""
    return jnp.clip(z, reduce(jnp.minimum, nodes), reduce(jnp.maximum, nodes))
