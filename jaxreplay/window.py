"""A window that travels with the belief, so that a step's cost does not grow with the records.

The equations run unchanged on a *view*: the records cut to the W moments that are held, with
their lengths counted from the window's start. What moves is the start. A belief that is wider
than its window loses what falls off either edge, and `Belief.dropped` keeps how likely the
likeliest lost hypothesis was, in bits. That matters even where it is tiny: a hypothesis of 2^-100
may win later, when an observation rules out all others. Do a step that lost too much again, from
the belief before it brought to a wider window by :func:`resize`. After t steps τ ≤ 2 t, so the
first (W − 1) / 2 lose nothing.
"""

import dataclasses
from functools import partial
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from jaxreplay.records import Records
from jaxreplay.scaled import LOWEST, Scaled, less
from jaxreplay.stage import stage

if TYPE_CHECKING:
    from jaxreplay.filter import Belief

STRIDE = 8  # moments a window moves by, or not at all
REACH = 2  # moments a step of equation 4 advances at most
NOTHING = 2 * LOWEST  # bits of a hypothesis that was not there
_BEHIND, _AHEAD = slice(None, STRIDE), slice(-STRIDE, None)


def view(records: Records, belief: "Belief") -> Records:
    """The records as `[N, W]` moments from `belief.start`, for the equations to run on."""
    held = belief.p.mantissa.shape[-1]
    if held == records.longest:
        return records
    return dataclasses.replace(
        records,
        nodes=_cut(records.nodes, belief.start, held + 2),
        commands=_cut(records.commands, belief.start, held),
        lengths=records.lengths - belief.start,
    )


def follow(records: Records, belief: "Belief") -> "Belief":
    """Before a prediction, move windows on where more is about to leave in front than behind."""
    held = belief.p.mantissa.shape[-1]
    if held == records.longest:
        return belief
    axes = (0, 1) if belief.start.ndim == 0 else 1
    behind, ahead = (belief.p[:, part].sum(axes) for part in (_BEHIND, _AHEAD))
    room = records.longest - held - belief.start
    stride = jnp.where(less(behind, ahead), jnp.minimum(STRIDE, room), 0)

    column = jnp.arange(held)
    leaving = column < stride[..., None]
    p = _window(belief.p.padded((0, STRIDE)), stride, held)
    start = belief.start + stride
    passing = (column >= held - REACH) & (start + held < records.lengths)[:, None]
    lost = jnp.maximum(_bits(belief.p.where(leaving), belief), _bits(p.where(passing), belief))
    return belief._replace(p=p, start=start, dropped=jnp.maximum(belief.dropped, jnp.max(lost)))


def resize(records: Records, belief: "Belief", window: int | None) -> "Belief":
    """The same belief in a wider or narrower window; None holds all moments.

    A narrower one is laid where it loses least, and the loss counts as dropped.
    """
    held, wanted = belief.p.mantissa.shape[-1], min(window or records.longest, records.longest)
    if wanted >= held:
        start = jnp.clip(belief.start - (wanted - held) // 2, 0, records.longest - wanted)
        p = belief.p.padded((wanted - held, wanted - held))
        p = _window(p, start - belief.start + (wanted - held), wanted)
        return belief._replace(p=p, start=start)
    bits = _bits(belief.p, belief)
    bits = jnp.max(bits, axis=0) if belief.start.ndim == 0 else bits
    nothing = jnp.full((*bits.shape[:-1], 1), NOTHING)
    before = jnp.concatenate([nothing, jax.lax.cummax(bits, axis=bits.ndim - 1)], axis=-1)
    after = jax.lax.cummax(bits, axis=bits.ndim - 1, reverse=True)
    after = jnp.concatenate([after, nothing], axis=-1)
    lost = jnp.maximum(before[..., : held - wanted + 1], after[..., wanted:])
    cut = jnp.argmin(lost, axis=-1).astype(belief.start.dtype)
    dropped = jnp.maximum(belief.dropped, jnp.max(jnp.min(lost, axis=-1)))
    return belief._replace(
        p=_window(belief.p, cut, wanted), start=belief.start + cut, dropped=dropped
    )


def _bits(part: Scaled, belief: "Belief") -> jax.Array:
    """log2 of probabilities `[N, …]`, rounded down, in each record's own if they are kept apart."""
    of = 0 if belief.start.ndim == 0 else jnp.max(belief.p.exponent, axis=1, keepdims=True)
    return jnp.where(part.mantissa == 0, NOTHING, jnp.maximum(part.exponent - of, NOTHING))


def _window(p: Scaled, start: jax.Array, width: int) -> Scaled:
    return Scaled(_cut(p.mantissa, start, width), _cut(p.exponent, start, width))


def _cut(array: jax.Array, start: jax.Array, width: int) -> jax.Array:
    """`width` columns of `[…, N, columns]`, from one start or from one for each of the N."""
    # Stages, for by itself a slice copies rows, within a larger loop numbers.
    cut = partial(jax.lax.dynamic_slice_in_dim, slice_size=width, axis=-1)
    if start.ndim == 0:
        return stage(cut)(array, start)
    # One slice for each row, as leading axis: of any other axis XLA would first copy the array.
    rows = array.reshape(-1, array.shape[-1])
    starts = jnp.broadcast_to(start, array.shape[:-1]).ravel()
    return stage(jax.vmap(cut))(rows, starts).reshape(*array.shape[:-1], width)
