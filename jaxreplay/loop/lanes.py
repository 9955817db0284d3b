"""The filter's side of a control step, compiled for many replays in windows of one width."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter import build_filter
from jaxreplay.filter.belief import NOTHING_DROPPED, Belief, Jump
from jaxreplay.filter.distance import distance
from jaxreplay.filter.numerics.stage import stage
from jaxreplay.filter.steps import update
from jaxreplay.filter.window import resize

# Processors with 512-bit registers run the step 25 % faster with it; XLA uses half of such a
# register by default.
# XLA's older emitters of fused loops compile in two thirds of the time; the step takes 5 % longer.
# One part, and LLVM's second level instead of its third, compile in three quarters of it, to the
# same results in the same time.
COMPILER_OPTIONS = {
    "xla_cpu_prefer_vector_width": 512,
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_parallel_codegen_split_count": 1,
    "xla_backend_optimization_level": 2,
}


class Results(NamedTuple):
    """Results of a control step.

    Where too much was dropped, the belief was left unchanged and the rest is to be ignored.

    Attributes:
        command: `[B, n_u]` for the next step.
        log_evidence: `[B]` log p(Z_t | Z_{1:t−1}).
        end_probability: `[B]` p(τ in the last samples), after the update with Z_t.
        distance: `[B]` from Z_t to the most probable state, see :mod:`jaxreplay.filter.distance`.
        dropped: `[B]` log2 of the most probable hypothesis that the step dropped.
        too_much: `[B]` 1 where that exceeds the limit, else 0.
    """

    command: np.ndarray
    log_evidence: np.ndarray
    end_probability: np.ndarray
    distance: np.ndarray
    dropped: np.ndarray
    too_much: np.ndarray


class Steps(NamedTuple):
    """The compiled steps for B replays whose beliefs are in windows of one width.

    All take `beliefs` of B replays and choose which to work on: `chosen`, `[B]` indices, of which
    those of B, at the end, do not count. They return the beliefs, and `[B, …]` results; those of
    `observe` in the columns of one array, for :func:`results_of`. The buffers of `beliefs` are
    donated. `begin` puts beliefs where replays start, to be followed by an observation of no
    sensor. `move` copies beliefs from `source`, in windows of another width, into windows of this
    width. Records are centred, and so are observations.
    """

    begin: Callable  # (records, beliefs, chosen, start) → beliefs
    observe: Callable  # (…, params, beliefs, chosen, z, droppable, last_steps) → beliefs, results
    move: Callable  # (records, source, beliefs, chosen) → beliefs, dropped


def results_of(columns: jax.Array) -> Results:
    """Return the results that :class:`Steps` has in columns (one array is copied faster)."""
    copied = np.array(columns)
    scalars = len(Results._fields) - 1
    return Results(copied[:, :-scalars], *copied.T[-scalars:])


def steps(jump: Jump, window: int | None) -> Steps:
    """Return the steps for one reading of a jump and one width of windows."""
    return _steps(jump, window, _each if jax.default_backend() == "cpu" else _together)


@cache
def _steps(jump: Jump, window: int | None, over_lanes: Callable) -> Steps:
    filter = build_filter(jump, window)

    def begin(records, beliefs, chosen, start):
        belief = filter.init(records, start)
        return jax.tree.map(lambda x, y: x.at[chosen].set(y, mode="drop"), beliefs, belief)

    def observe(records, params, beliefs, chosen, z, droppable, last_steps):
        def one(b, before):
            belief, log_evidence = update(records, lane(params, b), _fresh(before), z[b])
            end_probability = filter.end_probability(records, belief, last_steps)
            apart = distance(records, lane(params, b), belief, z[b])
            belief = filter.predict(records, lane(params, b), belief)
            command = filter.command(records, belief)
            too_much = belief.dropped > droppable[b]
            scalars = [log_evidence, end_probability, apart, belief.dropped, too_much]
            kept = jax.tree.map(lambda x, y: jnp.where(too_much, x, y), before, belief)
            return kept, jnp.concatenate([command, jnp.stack(scalars)])

        return over_lanes(one, beliefs, chosen)

    def move(records, source, beliefs, chosen):
        def one(b, _):
            belief = resize(records, _fresh(lane(source, b)), window)
            return belief, belief.dropped

        return over_lanes(one, beliefs, chosen)

    return Steps(
        jax.jit(begin, donate_argnums=1, static_argnums=3),
        jax.jit(observe, donate_argnums=2, compiler_options=COMPILER_OPTIONS),
        jax.jit(move, donate_argnums=2, compiler_options=COMPILER_OPTIONS),
    )


def lane(batch, b):
    """Return replay b of a batched pytree."""
    return jax.tree.map(lambda x: x[b], batch)


def _fresh(belief: Belief) -> Belief:
    """Return the belief with nothing dropped yet."""
    return replace(belief, dropped=jnp.asarray(NOTHING_DROPPED, jnp.int32))


def _each(one: Callable, beliefs: Belief, chosen: jax.Array):
    """Step the chosen replays one after the other, so that each stays in the processor's cache."""
    shapes = jax.eval_shape(one, chosen[0], lane(beliefs, chosen[0]))[1]
    results = jax.tree.map(lambda x: jnp.zeros((len(chosen), *x.shape), x.dtype), shapes)

    def body(k, so_far):
        b = chosen[k]
        # A stage: else the step reads all beliefs in many places, and XLA copies them all for it.
        new = one(b, stage(lane)(so_far[0], b))
        return jax.tree.map(lambda x, y: x.at[b].set(y), so_far, new)

    return jax.lax.fori_loop(0, jnp.sum(chosen < len(chosen)), body, (beliefs, results))


def _together(one: Callable, beliefs: Belief, chosen: jax.Array):
    """Step all replays at once, so that an accelerator is busy; keep what was not chosen."""
    new, results = jax.vmap(one)(jnp.arange(len(chosen)), beliefs)
    now = jnp.zeros(len(chosen), bool).at[chosen].set(True, mode="drop")
    keep = jax.vmap(lambda now, x, y: jax.tree.map(partial(jnp.where, now), x, y))
    return keep(now, new, beliefs), results
