"""Equation 2 computed for one block of samples after the other."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from jaxreplay.filter.numerics.scaled import Scaled

# Samples in a block. Intermediate arrays then take a few MB instead of tens of MB, which the C
# library would return to the system after each step: with N = 50, L = 5000 the new pages took most
# of a step's time (34 ms, against 10 ms in blocks).
BLOCK = 2**15


def in_blocks(likelihoods: Callable[[jax.Array], Scaled], nodes: jax.Array) -> Scaled:
    """Return `likelihoods(nodes)`, computed block by block where there are many.

    Args:
        likelihoods: a function of `[n_s, n]` nodes that returns `[n]` likelihoods, of which the
            last two are unused, and number j depends on nodes j, j + 1 and j + 2.
        nodes: `[n_s, n]`.

    Returns:
        `[n]` likelihoods, of which the last two are unused.
    """
    n_samples = nodes.shape[1] - 2
    n_blocks = -(-n_samples // BLOCK)
    if n_blocks == 1:
        return likelihoods(nodes)
    size = -(-n_samples // n_blocks)

    def fill(k: jax.Array, filled: Scaled) -> Scaled:
        start = jnp.minimum(k * size, n_samples - size)  # the last block overlaps the one before
        block = likelihoods(jax.lax.dynamic_slice_in_dim(nodes, start, size + 2, axis=1))
        put = partial(jax.lax.dynamic_update_slice_in_dim, start_index=start, axis=0)
        return jax.tree.map(put, filled, block)

    shapes = jax.eval_shape(likelihoods, nodes)
    empty = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return jax.lax.fori_loop(0, n_blocks, fill, empty)
