"""The exact means of long segments, put in the place of those that the series gave."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxreplay.filter.numerics.blocks import Block
from jaxreplay.filter.numerics.segment import LONG, Mean, Sensor, length, long_mean
from jaxreplay.filter.numerics.stage import stage
from jaxreplay.records import CHUNK, Records

_CERTAIN = 0.99  # of the limit: what rounding may have put on its other side counts as long
_staged_long_mean = stage(long_mean)
_LISTED = 9  # times that a segment from the list takes, compared with one among all segments


def with_long_segments(records: Records, block: Block, means: Mean) -> Mean:
    """Replace the means along long segments.

    As many chunks of the records' list are computed as contain a long segment of any sensor; where
    these are many, all segments are computed exactly instead, which then is faster.

    Args:
        records: N records.
        block: part of their nodes.
        means: `[group, n − 1]` of the segments between the block's nodes.

    Returns:
        The means.
    """
    group, n_segments = means.peak.shape
    longest = jax.lax.dynamic_slice_in_dim(records.long.longest, block.first, group)
    sensors = Sensor(*(x[:, None] for x in block.sensors))
    # A missing sensor, whose inverse is 0, has no long segment.
    chunks = jnp.max(jnp.sum(_is_long(longest * sensors.inverse), axis=1))
    many = chunks * (CHUNK * _LISTED) > n_segments
    # Two loops of which one is never entered: branches of a condition would copy the means.
    means = jax.lax.fori_loop(0, many.astype(jnp.int32), partial(_exact_everywhere, block), means)
    flat = Mean(*(x.reshape(-1) for x in means))
    flat = jax.lax.fori_loop(0, jnp.where(many, 0, chunks), partial(_put, records, block), flat)
    return Mean(*(x.reshape(group, n_segments) for x in flat))


def _is_long(length: jax.Array) -> jax.Array:
    return length > _CERTAIN * LONG[length.dtype]


def _put(records: Records, block: Block, c: jax.Array, flat: Mean) -> Mean:
    """Replace the means, end to end, of those segments in chunk c that are in the block."""
    long, group, n_segments = records.long, len(block.nodes), block.nodes.shape[1] - 1
    columns = records.nodes.shape[-1]
    record, place = (_cut(x, block.first, c, group) for x in long[1:3])
    start, end = (_cut(x, block.first, c, group) for x in long.ends)
    sensors = Sensor(*(x[:, None] for x in block.sensors))
    exact = _staged_long_mean(start, end, sensors)
    column = place - long.start[record]
    at = record * columns + column - block.start
    stored = (column >= 0) & (column < columns - 1) & (at >= 0) & (at < n_segments)
    stored &= _is_long(length(start, end, sensors))
    at = jnp.where(stored, jnp.arange(group)[:, None] * n_segments + at, group * n_segments)
    return Mean(*(x.at[at].set(y, mode="drop") for x, y in zip(flat, exact, strict=True)))


def _cut(listed: jax.Array, first: jax.Array | int, c: jax.Array, group: int) -> jax.Array:
    return jax.lax.dynamic_slice(listed, (first, c * CHUNK), (group, CHUNK))


def _exact_everywhere(block: Block, k: jax.Array, means: Mean) -> Mean:
    """Replace the means along all long segments."""
    # Tied to the loop's counter, or XLA would compute this before the loop, entered or not.
    z, _ = jax.lax.optimization_barrier((block.sensors.z, k))
    sensors = Sensor(*(x[:, None] for x in block.sensors._replace(z=z)))
    exact, is_long = _exact(block.nodes, sensors)
    return Mean(*(jnp.where(is_long, x, y) for x, y in zip(exact, means, strict=True)))


@stage
def _exact(nodes: jax.Array, sensors: Sensor) -> tuple[Mean, jax.Array]:
    start, end = nodes[:, :-1], nodes[:, 1:]
    return long_mean(start, end, sensors), _is_long(length(start, end, sensors))
