"""The observation model (§ 2.2.2): a Gaussian convolved with the segments of a record."""

import jax
import jax.numpy as jnp

from jaxreplay.filter.numerics.anchor import log_density, measured_only
from jaxreplay.filter.numerics.blocks import in_blocks
from jaxreplay.filter.numerics.gaussian import segment_mean, sensor_terms
from jaxreplay.filter.numerics.scaled import Scaled, product
from jaxreplay.filter.numerics.stage import stage
from jaxreplay.params import Params
from jaxreplay.records import Records

__all__ = ["likelihood", "log_density"]


def likelihood(records: Records, params: Params, z: jax.Array, anchor: jax.Array) -> Scaled:
    """Compute equation 2, p(Z_t | I_t = i, τ_t = j) for all i and j, relative to an anchor.

        ∏_k ½ [mean of N over ζ_{j−1} … ζ_j  +  mean of N over ζ_j … ζ_{j+1}]_k

    Far from all records (hundreds of σ) these densities can differ by less than the rounding of
    their logarithms. Therefore each is divided by N(z; anchor, σ²). The anchor is one point, the
    same for all i and j, about as near the observation as the nearest record. The factor cancels
    in equation 9; :func:`log_density` gives it.

    The paper leaves these points open; here: N(t, σ²) is the normal density of Z_t − t; the first
    and last sample of a record touch one segment, which carries full weight; a segment of length
    zero is the point Gaussian, its limit, and so is a record of one sample.

    Args:
        records: N records, centred (see `Records.centred`).
        params: σ is used.
        z: `[n_s]` the centred observation Z_t; NaN marks a missing sensor, which contributes no
            factor.
        anchor: `[n_s]` any point, centred, in the sensors' units; the best is that of
            `numerics.anchor.anchor_point`.

    Returns:
        `[N, L]` p(Z_t | i, j) / N(Z_t; anchor, σ²). Entries past a record's end are arbitrary.
    """
    z, measured = measured_only(records, z)
    terms = sensor_terms(params.sigma, z, anchor)

    def likelihoods(nodes: jax.Array) -> Scaled:
        return _likelihoods(segment_mean(nodes, terms), measured[:, None])

    every_node = records.nodes.reshape(records.n_sensors, -1)  # records end to end
    return jax.tree.map(
        lambda x: x.reshape(records.n_records, -1)[:, :-2], in_blocks(likelihoods, every_node)
    )


@stage
def _likelihoods(segments: Scaled, measured: jax.Array) -> Scaled:
    """Average the two segments at every sample, and multiply over sensors.

    Args:
        segments: `[n_s, n − 1]` means over the segments between n nodes: all records end to end,
            each with a mirrored node before its first sample and after its last (see
            `Records.nodes`).
        measured: `[n_s, 1]` False for a missing sensor.

    Returns:
        `[n]`; entry m is that of the sample at node m + 1. The last two of each record, and of the
        whole, belong to no sample.
    """
    left, right = segments[:, :-1], segments[:, 1:]
    exponent = jnp.maximum(left.exponent, right.exponent)
    both = left.at(exponent) + right.at(exponent)
    halves = Scaled(jnp.where(measured, both, 2.0), jnp.where(measured, exponent, 0) - 1)
    return jax.tree.map(lambda x: jnp.pad(x, (0, 2)), product(halves))
