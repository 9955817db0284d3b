"""The filter's side of a control step, compiled for many replays in windows of one width."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxreplay.filter import build_filter
from jaxreplay.filter.belief import NOTHING_DROPPED, Belief, Jump
from jaxreplay.filter.steps import update
from jaxreplay.filter.window import resize

# Processors with 512-bit registers run the step 25 % faster with it; XLA uses half of such a
# register by default.
COMPILER_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


class Results(NamedTuple):
    """Results of a control step.

    Where `dropped` exceeds the limit, the belief was left unchanged and the rest is to be ignored.

    Attributes:
        command: `[B, n_u]` for the next step.
        log_evidence: `[B]` log p(Z_t | Z_{1:t−1}).
        end_probability: `[B]` p(τ in the last 10 samples), after the update with Z_t.
        dropped: `[B]` log2 of the most probable hypothesis that the step dropped, int32.
    """

    command: jax.Array
    log_evidence: jax.Array
    end_probability: jax.Array
    dropped: jax.Array


class Steps(NamedTuple):
    """The compiled steps for B replays whose beliefs are in windows of one width.

    All take `beliefs` of B replays and choose which to work on: `chosen`, `[B]` indices, of which
    the first n count. They return the beliefs, and `[B, …]` results. The buffers of `beliefs` are
    donated. `move` copies beliefs from `source`, in windows of another width, into windows of this
    width. Records are centred, and so are observations.
    """

    begin: Callable  # (records, params, beliefs, chosen, n) → beliefs, command
    observe: Callable  # (records, params, beliefs, chosen, n, z, droppable) → beliefs, Results
    move: Callable  # (records, source, beliefs, chosen, n) → beliefs, dropped


@cache
def steps(jump: Jump, window: int | None) -> Steps:
    """Return the steps for one reading of a jump and one width of windows."""
    filter = build_filter(jump, window)

    def begin(records, params, beliefs, chosen, n):
        def one(b, belief):
            belief = filter.predict(records, lane(params, b), filter.init(records))
            return belief, filter.command(records, belief)

        return _each(one, beliefs, chosen, n)

    def observe(records, params, beliefs, chosen, n, z, droppable):
        def one(b, before):
            belief, log_evidence = update(records, lane(params, b), _fresh(before), z[b])
            end_probability = filter.end_probability(records, belief)
            belief = filter.predict(records, lane(params, b), belief)
            command = filter.command(records, belief)
            results = Results(command, log_evidence, end_probability, belief.dropped)
            too_much = belief.dropped > droppable[b]
            return jax.tree.map(lambda x, y: jnp.where(too_much, x, y), before, belief), results

        return _each(one, beliefs, chosen, n)

    def move(records, source, beliefs, chosen, n):
        def one(b, _):
            belief = resize(records, _fresh(lane(source, b)), window)
            return belief, belief.dropped

        return _each(one, beliefs, chosen, n)

    return Steps(
        jax.jit(begin, donate_argnums=2),
        jax.jit(observe, donate_argnums=2, compiler_options=COMPILER_OPTIONS),
        jax.jit(move, donate_argnums=2),
    )


def lane(batch, b):
    """Return replay b of a batched pytree."""
    return jax.tree.map(lambda x: x[b], batch)


def _fresh(belief: Belief) -> Belief:
    """Return the belief with nothing dropped yet."""
    return replace(belief, dropped=jnp.asarray(NOTHING_DROPPED, jnp.int32))


def _each(one: Callable, beliefs: Belief, chosen: jax.Array, n: jax.Array):
    """Step the chosen replays one after the other, so that each stays in the processor's cache."""
    shapes = jax.eval_shape(one, chosen[0], lane(beliefs, chosen[0]))[1]
    results = jax.tree.map(lambda x: jnp.zeros((len(chosen), *x.shape), x.dtype), shapes)

    def body(k, so_far):
        b = chosen[k]
        new = one(b, lane(so_far[0], b))
        return jax.tree.map(lambda x, y: x.at[b].set(y), so_far, new)

    return jax.lax.fori_loop(0, n, body, (beliefs, results))
