"""The longest segments of each sensor first: where equation 2 needs its exact form."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

CHUNK = 128  # segments of each sensor that are taken from the list at a time


class LongestFirst(NamedTuple):
    """All M segments of each sensor, the longest first, in chunks of `CHUNK`.

    The list is filled up with segments of length zero.

    Attributes:
        longest: `[n_s, M / CHUNK]` the length of each chunk's first segment, in the sensor's unit.
        record: `[n_s, M]` int32.
        place: `[n_s, M]` int32, the number of the segment in its record: from node `place` to the
            next (see `Records.nodes`).
        ends: `[2, n_s, M]` those two nodes.
        start: `[N]` int32, the segment at which each record's window begins; 0 without a window.
    """

    longest: jax.Array
    record: jax.Array
    place: jax.Array
    ends: jax.Array
    start: jax.Array


def longest_first(nodes: np.ndarray, lengths: np.ndarray) -> LongestFirst:
    """Return the list for nodes `[n_s, N, L + 2]` of records of these lengths, `[N]`."""
    apart = np.abs(np.diff(nodes.astype(np.float64)))
    apart[:, np.arange(apart.shape[2]) > lengths[:, None]] = 0
    n_segments = apart.shape[2]
    apart = apart.reshape(len(nodes), -1)
    order = np.argsort(-apart, axis=1, kind="stable")
    record, place = np.divmod(order, n_segments)
    sensor = np.arange(len(nodes))[:, None]
    fill = ((0, 0), (0, -order.shape[1] % CHUNK))
    ends = np.array([nodes[sensor, record, place + k] for k in range(2)])
    return LongestFirst(
        longest=jnp.asarray(np.take_along_axis(apart, order, 1)[:, ::CHUNK], nodes.dtype),
        record=jnp.asarray(np.pad(record, fill), jnp.int32),
        place=jnp.asarray(np.pad(place, fill), jnp.int32),
        ends=jnp.asarray(np.pad(ends, ((0, 0), *fill))),
        start=jnp.zeros(len(lengths), jnp.int32),
    )
