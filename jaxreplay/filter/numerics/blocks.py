"""Sums over sensors computed for a part of them after the other, and a part of the samples."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxreplay.filter.numerics.segment import Sensor

# Samples in a block. Intermediate arrays then take a few MB instead of tens of MB, which the C
# library would return to the system after each step: with N = 50, L = 5000 the new pages took most
# of a step's time (34 ms, against 10 ms in blocks).
BLOCK = 2**15
GROUP = 8  # sensors that a compiled program unrolls, so that it has one size for any n_s


class Block(NamedTuple):
    """Some nodes of some sensors.

    Attributes:
        nodes: `[group, n]`.
        sensors: `[group]` values; a sensor whose `inverse` is 0 is to add nothing.
        first: number of the first sensor.
        start: number of the first node, in all records end to end.
    """

    nodes: jax.Array
    sensors: Sensor
    first: jax.Array | int
    start: jax.Array | int


def in_blocks(sums: Callable[[Block], jax.Array], nodes: jax.Array, sensors: Sensor) -> jax.Array:
    """Return sums over the sensors, computed by blocks of samples and groups of sensors.

    Args:
        sums: a function that returns a block's `[n]` sums, of which the last two are unused, and
            number j depends on nodes j, j + 1 and j + 2.
        nodes: `[n_s, n]`, all records end to end.
        sensors: `[n_s]` values.

    Returns:
        `[n]` sums, of which the last two are unused.
    """
    n_sensors, n_nodes = nodes.shape
    n_groups, group = _parts(n_sensors, GROUP)
    n_blocks, size = _parts(n_nodes - 2, BLOCK)

    def add_up(start: jax.Array | int, size: int) -> jax.Array:
        def add(g: jax.Array, logs: jax.Array) -> jax.Array:
            first = jnp.minimum(g * group, n_sensors - group)  # the last overlaps the one before
            part = Sensor(*(jax.lax.dynamic_slice_in_dim(x, first, group) for x in sensors))
            new = first + jnp.arange(group) >= g * group
            part = part._replace(inverse=jnp.where(new, part.inverse, 0.0))
            cut = jax.lax.dynamic_slice(nodes, (first, start), (group, size))
            return logs + sums(Block(cut, part, first, start))

        if n_groups == n_blocks == 1:
            return sums(Block(nodes, sensors, 0, 0))
        return jax.lax.fori_loop(0, n_groups, add, jnp.zeros(size, nodes.dtype))

    if n_blocks == 1:
        return add_up(0, n_nodes)

    def fill(k: jax.Array, filled: jax.Array) -> jax.Array:
        start = jnp.minimum(k * size, n_nodes - 2 - size)  # the last overlaps the one before
        return jax.lax.dynamic_update_slice(filled, add_up(start, size + 2), (start,))

    return jax.lax.fori_loop(0, n_blocks, fill, jnp.zeros(n_nodes, nodes.dtype))


def _parts(n: int, most: int) -> tuple[int, int]:
    """Return into how many parts of at most `most` to cut n, and their size."""
    parts = -(-n // most)
    return parts, -(-n // parts)
