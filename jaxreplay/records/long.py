"""The longest segments of all records first: where equation 2 needs its exact form."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

CHUNK = 768  # segments that are taken from the list at a time


class LongestFirst(NamedTuple):
    """All M segments of all sensors, the longest first, in chunks of `CHUNK`.

    Attributes:
        longest: `[M / CHUNK]` the length of each chunk's first segment, as a share of its sensor's
            span.
        sensor: `[M]` int32; `n_s` where the list is filled up.
        record: `[M]` int32.
        place: `[M]` int32, the number of the segment in its record: from node `place` to the next
            (see `Records.nodes`).
        ends: `[2, M]` those two nodes.
        start: `[N]` int32, the segment at which each record's window begins; 0 without a window.
    """

    longest: jax.Array
    sensor: jax.Array
    record: jax.Array
    place: jax.Array
    ends: jax.Array
    start: jax.Array


def longest_first(nodes: np.ndarray, lengths: np.ndarray, span: np.ndarray) -> LongestFirst:
    """Return the list for nodes `[n_s, N, L + 2]`, lengths `[N]` and span `[2, n_s]`."""
    width = np.diff(span.astype(np.float64), axis=0)[0]
    share = np.abs(np.diff(nodes.astype(np.float64)))
    share /= np.where(width > 0, width, 1)[:, None, None]
    share[:, np.arange(share.shape[2]) > lengths[:, None]] = 0
    order = np.argsort(-share, axis=None, kind="stable")
    sensor, record, place = places = np.unravel_index(order, share.shape)
    longest = share[places][::CHUNK]
    fill = (0, len(longest) * CHUNK - len(order))
    ends = np.array([nodes[sensor, record, place + k] for k in range(2)])
    return LongestFirst(
        longest=jnp.asarray(longest, nodes.dtype),
        sensor=jnp.asarray(np.pad(sensor, fill, constant_values=len(nodes)), jnp.int32),
        record=jnp.asarray(np.pad(record, fill), jnp.int32),
        place=jnp.asarray(np.pad(place, fill), jnp.int32),
        ends=jnp.asarray(np.pad(ends, ((0, 0), fill))),
        start=jnp.zeros(len(lengths), jnp.int32),
    )
