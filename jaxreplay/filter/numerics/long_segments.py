"""The exact means of long segments, put in the place of those that the series gave."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxreplay.filter.numerics.blocks import Block
from jaxreplay.filter.numerics.segment import LONG, Mean, Sensor, length, long_mean
from jaxreplay.filter.numerics.stage import stage
from jaxreplay.records import CHUNK, Records

_CERTAIN = 0.99  # of the limit: what rounding may have put on its other side counts as long


def with_long_segments(records: Records, block: Block, means: Mean) -> Mean:
    """Replace the means along long segments.

    As many chunks of the records' list are computed as contain a long segment of any sensor.

    Args:
        records: N records.
        block: part of their nodes.
        means: `[group, n − 1]` of the segments between the block's nodes.

    Returns:
        The means.
    """
    long, sensors = records.long, block.sensors
    group, n_segments = means.peak.shape
    columns = records.nodes.shape[-1]
    # The largest share of its span that a sensor's short segments may have. A missing sensor has
    # no long segment.
    width = jax.lax.dynamic_slice_in_dim(records.span[1] - records.span[0], block.first, group)
    moves = (width > 0) & (sensors.inverse > 0)
    limits = jnp.where(moves, LONG[width.dtype] / (width * sensors.inverse), jnp.inf)

    def put(c: jax.Array, flat: Mean) -> Mean:
        cut = partial(
            jax.lax.dynamic_slice_in_dim, start_index=c * CHUNK, slice_size=CHUNK, axis=-1
        )
        sensor, record, place, ends = map(cut, long[1:-1])
        first, second = ends
        sensor -= block.first
        its = Sensor(*(values.at[sensor].get(mode="clip") for values in sensors))
        exact = stage(long_mean)(first, second, its)
        column = place - long.start[record]
        at = record * columns + column - block.start
        stored = (sensor >= 0) & (sensor < group) & (column >= 0) & (column < columns - 1)
        stored &= (at >= 0) & (at < n_segments)
        stored &= length(first, second, its) > _CERTAIN * LONG[width.dtype]
        at = jnp.where(stored, sensor * n_segments + at, group * n_segments)
        return Mean(*(x.at[at].set(y, mode="drop") for x, y in zip(flat, exact, strict=True)))

    chunks = jnp.sum(long.longest > _CERTAIN * jnp.min(limits))
    flat = jax.lax.fori_loop(0, chunks, put, Mean(*(x.reshape(-1) for x in means)))
    return Mean(*(x.reshape(group, n_segments) for x in flat))
