"""The observation model (§ 2.2.2): a Gaussian convolved with the segments of a record."""

from functools import reduce

import jax
import jax.numpy as jnp

from jaxreplay.filter.numerics.anchor import log_density, measured
from jaxreplay.filter.numerics.blocks import Block, in_blocks
from jaxreplay.filter.numerics.long_segments import with_long_segments
from jaxreplay.filter.numerics.segment import Mean, Sensor, mean_of_two, short_mean
from jaxreplay.filter.numerics.stage import stage
from jaxreplay.params import Params
from jaxreplay.records import Records

__all__ = ["likelihood", "log_density"]


def likelihood(records: Records, params: Params, z: jax.Array, anchor: jax.Array) -> jax.Array:
    """Compute equation 2, log p(Z_t | I_t = i, τ_t = j) for all i and j, relative to an anchor.

        ∏_k ½ [mean of N over ζ_{j−1} … ζ_j  +  mean of N over ζ_j … ζ_{j+1}]_k

    Each density is divided by N(z; anchor, σ²), so that states near the anchor keep their digits
    however far the observation is. The anchor is one point, the same for all i and j. The factor
    cancels in equation 9; :func:`log_density` gives it.

    The paper leaves these points open; here: N(t, σ²) is the normal density of Z_t − t; the first
    and last sample of a record touch one segment, which carries full weight; a segment of length
    zero is the point Gaussian, its limit, and so is a record of one sample.

    Args:
        records: N records, centred (see `Records.centred`).
        params: σ is used; the result is differentiable in it alone.
        z: `[n_s]` the centred observation Z_t; NaN marks a missing sensor, which contributes no
            factor.
        anchor: `[n_s]` any point, centred, in the sensors' units; the best is that of
            `numerics.anchor.anchor_point`.

    Returns:
        `[N, L]` log p(Z_t | i, j) − log N(Z_t; anchor, σ²). Entries past a record's end are
        arbitrary.
    """
    return _likelihood(params.sigma, records, z, anchor)


@jax.custom_jvp
def _likelihood(sigma, records, z, anchor):
    every_node = records.nodes.reshape(records.n_sensors, -1)  # records end to end
    sensors = _sensors(sigma, records, z, anchor)
    logs = in_blocks(lambda block: _log_product(_means(records, block)), every_node, sensors)
    return logs.reshape(records.n_records, -1)[:, :-2]


@_likelihood.defjvp
def _tangent(primals, tangents):
    """Add up d log(mean_k) / dσ_k · dσ_k: the mean of a sensor depends on its own σ alone."""
    sigma, records, z, anchor = primals

    def logs(sigma):
        every_node = records.nodes.reshape(records.n_sensors, -1)
        block = Block(every_node, _sensors(sigma, records, z, anchor), 0, 0)
        mean = _halves(_means(records, block))
        return jnp.pad(mean.peak + jnp.log(mean.factor), ((0, 0), (0, 2)))

    slopes = jax.jvp(logs, (sigma,), (jnp.ones_like(sigma),))[1]
    slope = jnp.tensordot(tangents[0], slopes, 1).reshape(records.n_records, -1)[:, :-2]
    return _likelihood(*primals), slope


def _sensors(sigma, records, z, anchor) -> Sensor:
    z, inverse = measured(records, sigma, z)
    return Sensor(z, anchor, inverse)


def _means(records: Records, block: Block) -> Mean:
    """Return the means along the segments between the block's nodes."""
    return with_long_segments(records, block, _short_means(block.nodes, block.sensors))


@stage
def _short_means(nodes: jax.Array, sensors: Sensor) -> Mean:
    return short_mean(nodes[:, :-1], nodes[:, 1:], Sensor(*(x[:, None] for x in sensors)))


def _halves(segments: Mean) -> Mean:
    """Average the two segments that meet at each node but the first and the last."""
    return mean_of_two(Mean(*(x[:, :-1] for x in segments)), Mean(*(x[:, 1:] for x in segments)))


@stage
def _log_product(segments: Mean) -> jax.Array:
    """Return log of the product over sensors; the last two are of no sample."""
    mean = _halves(segments)
    logs = reduce(jnp.add, mean.peak) + jnp.log(reduce(jnp.multiply, mean.factor))
    return jnp.pad(logs, (0, 2))
