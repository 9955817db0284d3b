"""A window that travels with the belief: a step's cost does not grow with the records' length.

The equations run unchanged on a *view*: the records cut to the W samples in the window, their
lengths counted from its start. A belief wider than its window loses probability at both edges, and
`Belief.dropped` records the most probable hypothesis lost, as a log2. The loss matters even where
it is tiny: a hypothesis of 2^-100 may win later, when an observation rules out all others. A step
that dropped too much can be computed again from the belief before it, which :func:`resize` brings
to a wider window. After t steps τ ≤ 2 t: while 2 t < W − STRIDE no probability has reached the
leading `STRIDE` columns, so no window has moved and nothing is lost.
"""

import dataclasses
from collections.abc import Callable
from functools import cache, partial

import jax
import jax.numpy as jnp

from jaxreplay.filter.belief import NOTHING_DROPPED, Belief
from jaxreplay.filter.numerics.scaled import Scaled, less
from jaxreplay.filter.numerics.stage import stage
from jaxreplay.records import Records

STRIDE = 8  # samples that a window moves at a time
REACH = 2  # samples that a step of equation 4 advances at most
NARROWEST = 4 * STRIDE  # samples; a narrower window loses what it should follow
_BEHIND, _AHEAD = slice(None, STRIDE), slice(-STRIDE, None)


def view(records: Records, belief: Belief) -> Records:
    """Return the records cut to the belief's window, `[N, W]` samples from `belief.start`."""
    if belief.window is None:
        return records
    return dataclasses.replace(
        records,
        nodes=_cut(records.nodes, belief.start, belief.window + 2),
        commands=_cut(records.commands, belief.start, belief.window),
        lengths=records.lengths - belief.start,
        long=records.long._replace(start=records.long.start + belief.start),
    )


def follow(records: Records, belief: Belief) -> Belief:
    """Shift a window whose leading `STRIDE` columns hold more probability than its trailing ones.

    It shifts by `STRIDE`, or by what is left to the records' end. To be called before a prediction.
    Under `own_tau` each record has its own window, and they shift independently.
    """
    width = belief.window
    if width is None:
        return belief
    axes = (0, 1) if belief.jump == "same_tau" else 1
    behind, ahead = (belief.p[:, part].sum(axes) for part in (_BEHIND, _AHEAD))
    room = records.longest - width - belief.start
    stride = jnp.where(less(behind, ahead), jnp.minimum(STRIDE, room), 0)

    p = _window(belief.p.padded((0, STRIDE)), stride, width)
    moved = dataclasses.replace(belief, p=p, start=belief.start + stride)
    # What a shift leaves behind: one for all records, or for each.
    leaving = jnp.arange(STRIDE)[None] < stride.reshape(-1, 1)
    # What the coming prediction may carry past the leading edge.
    passing = (moved.start + width < records.lengths)[:, None]
    lost = jnp.maximum(
        jnp.max(_bits(moved, belief.p[:, _BEHIND].where(leaving))),
        jnp.max(_bits(moved, p[:, -REACH:].where(passing))),
    )
    return dataclasses.replace(moved, dropped=jnp.maximum(belief.dropped, lost))


def resize(records: Records, belief: Belief, window: int | None) -> Belief:
    """Return the belief in a wider or narrower window; None stores all samples.

    A narrower window is placed where it loses least, and the loss counts as dropped.
    """
    if window is not None and window >= records.longest:
        window = None
    width, wanted = belief.window or records.longest, window or records.longest
    if wanted >= width:
        start = jnp.clip(belief.start - (wanted - width) // 2, 0, records.longest - wanted)
        p = belief.p.padded((wanted - width, wanted - width))
        p = _window(p, start - belief.start + (wanted - width), wanted)
        return dataclasses.replace(belief, p=p, start=start, window=window)
    bits = _bits(belief, belief.p)
    bits = jnp.max(bits, axis=0) if belief.jump == "same_tau" else bits
    nothing = jnp.full((*bits.shape[:-1], 1), NOTHING_DROPPED)
    before = jnp.concatenate([nothing, jax.lax.cummax(bits, axis=bits.ndim - 1)], axis=-1)
    after = jax.lax.cummax(bits, axis=bits.ndim - 1, reverse=True)
    after = jnp.concatenate([after, nothing], axis=-1)
    lost = jnp.maximum(before[..., : width - wanted + 1], after[..., wanted:])
    cut = jnp.argmin(lost, axis=-1).astype(belief.start.dtype)
    return dataclasses.replace(
        belief,
        p=_window(belief.p, cut, wanted),
        start=belief.start + cut,
        dropped=jnp.maximum(belief.dropped, jnp.max(jnp.min(lost, axis=-1))),
        window=window,
    )


def _bits(belief: Belief, part: Scaled) -> jax.Array:
    """Return log2 of `part`, `[N, …]` probabilities of the belief, right to within two bits.

    Under `own_tau`, where each record keeps a distribution of its own, it is relative to the most
    probable sample of the record.
    """
    top = 0
    if belief.jump == "own_tau":
        top = jnp.max(belief.p.exponent, axis=1, keepdims=True)
    bits = jnp.maximum(part.exponent - top, NOTHING_DROPPED)
    return jnp.where(part.mantissa == 0, NOTHING_DROPPED, bits)


def _window(p: Scaled, start: jax.Array, width: int) -> Scaled:
    return Scaled(_cut(p.mantissa, start, width), _cut(p.exponent, start, width))


def _cut(array: jax.Array, start: jax.Array, width: int) -> jax.Array:
    """Return `width` columns of `[…, N, columns]`, from one start or from one for each of the N."""
    one, each = _cuts(width)
    if start.ndim == 0:
        return one(array, start)
    # One slice for each row, rows being the leading axis: for any other axis XLA would first copy
    # the whole array.
    rows = array.reshape(-1, array.shape[-1])
    starts = jnp.broadcast_to(start, array.shape[:-1]).ravel()
    return each(rows, starts).reshape(*array.shape[:-1], width)


@cache
def _cuts(width: int) -> tuple[Callable, Callable]:
    """Return functions that cut `width` columns, from one start and from one for each row."""
    # In a stage of its own XLA copies whole rows; fused into a larger loop, single numbers.
    cut = partial(jax.lax.dynamic_slice_in_dim, slice_size=width, axis=-1)
    return stage(cut), stage(jax.vmap(cut))
