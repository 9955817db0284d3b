"""Replays tracked together: the steps of the filter compiled as one, in windows that fit."""

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter import Belief, build_filter, update
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.window import NOTHING, resize

WINDOWS = (256, 512, None)  # moments of each record held; None is all
NARROW_EVERY = 16  # steps
DROPPABLE = -6000  # bits of the likeliest hypothesis that a step may drop at its window's edges

# Processors with registers of 512 bits gain a quarter; XLA uses half of them by default.
COMPILER_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


class Steps(NamedTuple):
    """The filter's side of a control step, for a chunk of replays."""

    begin: Callable  # (records, params) → belief, command
    advance: Callable  # (records, params, belief, z, going) → belief, command, evidence, p(end)


@cache
def steps(jump: str, window: int | None) -> Steps:
    """The filter's steps, compiled for windows of one width."""
    filter = build_filter(jump, window)

    def predict(records: Records, params: Params, belief: Belief):
        belief = filter.predict(records, params, belief)
        return belief, filter.command(records, belief)

    def begin(records, params):
        return jax.lax.map(lambda one: predict(records, one, filter.init(records)), params)

    def advance(records, params, belief, z, going):
        def step(params, belief, z):
            belief = belief._replace(dropped=jnp.full_like(belief.dropped, NOTHING))
            belief, log_evidence = update(records, params, belief, z)
            ended = filter.end_probability(records, belief)
            return *predict(records, params, belief), log_evidence, ended

        def rest(params, belief, z):
            nothing = jnp.zeros((), records.nodes.dtype)
            return belief, jnp.zeros(records.n_commands, nothing.dtype), nothing, nothing

        # One after the other: what a replay needs stays in the processor's cache, and those
        # that have ended cost nothing. The chunks run side by side.
        return jax.lax.map(lambda one: jax.lax.cond(one[-1], step, rest, *one[:-1]), (
            params, belief, z, going,
        ))  # fmt: skip

    return Steps(jax.jit(begin), jax.jit(advance, compiler_options=COMPILER_OPTIONS))


class Tracker:
    """B replays that advance in one call, each belief in a window of its own width.

    A belief is kept as predicted, with the command that follows from it ready to be sent.
    No step drops a hypothesis likelier than 2^`DROPPABLE`: one that would is done again in a
    wider window, from the belief before it. A narrower one is tried again every so often.
    What becomes of a replay does not depend on those beside it.

    Attributes:
        command: `[B, n_u]` to be sent next.
        window: `[B]` which of `WINDOWS` each replay is in.
        widened: how often a step was done again.
    """

    def __init__(self, records: Records, params: Params, jump: str):
        """Start B replays.

        Args:
            records: N records.
            params: `[B]`-batched parameters.
            jump: `"same_tau"` or `"own_tau"`.
        """
        self.records, self.params, self.jump = records, params, jump
        belief, command = self._begin()
        self.command = np.array(command)
        self.window = np.zeros(len(command), int)
        self.widened = 0
        self._taken = np.zeros(len(command), int)
        self._beliefs = {0: belief}  # for each width; a replay's is where its window says

    def restart(self, which: np.ndarray, params: Params):
        """Begin again at the records' first samples, in the replays `[B]` told.

        Args:
            which: `[B]` replays.
            params: `[B]`-batched parameters of all replays from here on.
        """
        self.params = params
        belief, command = self._begin()
        self._put(0, belief, which)
        self._taken[which] = 0
        self.command[which] = np.asarray(command)[which]

    def advance(self, z: np.ndarray, going: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take in observations, and predict.

        Args:
            z: `[B, n_s]` Z_t.
            going: `[B]` which replays go on; the others rest.

        Returns:
            The log evidence gained and p(the end is reached), each `[B]`, 0 for those that rest.
        """
        z = self.records.centre(z)
        gained, ended = np.zeros(len(going)), np.zeros(len(going))
        for k, width in enumerate(WINDOWS):
            now = going & (self.window == k)
            if not now.any():
                continue
            before = self._beliefs[k]
            belief, *results = steps(self.jump, width).advance(
                self.records, self.params, before, z, now
            )
            lossy = now & (width is not None) & (np.asarray(belief.dropped) > DROPPABLE)
            if lossy.any():  # its turn is next
                self._put(k + 1, _resize(self.records, before, WINDOWS[k + 1]), lossy)
                self.widened += int(lossy.sum())
            self._beliefs[k] = belief
            for held, result in zip((self.command, gained, ended), results, strict=True):
                held[now & ~lossy] = np.asarray(result)[now & ~lossy]
        self._taken[going] += 1
        self._narrow(going & (self._taken % NARROW_EVERY == 0))
        return gained, ended

    def belief(self, b: int) -> Belief:
        """Of one replay, as predicted for the next step."""
        return jax.tree.map(lambda x: x[b], self._beliefs[self.window[b]])

    def compile(self):
        """Compile all that may be needed, so that no step waits for it."""
        nothing = np.full((len(self.window), self.records.n_sensors), np.nan)
        everyone = np.ones(len(self.window), bool)
        for k in (*range(len(WINDOWS)), *reversed(range(len(WINDOWS) - 1))):
            now = int(self.window[0])
            self._put(k, _resize(self.records, self._beliefs[now], WINDOWS[k]), everyone)
            self.advance(nothing, everyone)
        self.restart(everyone, self.params)
        self.widened = 0

    def _begin(self) -> tuple[Belief, jax.Array]:
        return steps(self.jump, WINDOWS[0]).begin(self.records, self.params)

    def _narrow(self, which: np.ndarray):
        for k in range(1, len(WINDOWS)):
            now = which & (self.window == k)
            if now.any():
                belief = _resize(self.records, self._beliefs[k], WINDOWS[k - 1])
                fits = np.asarray(belief.dropped) <= DROPPABLE - 4
                self._put(k - 1, belief, now & fits)

    def _put(self, k: int, belief: Belief, which: np.ndarray):
        """Let some replays go on in the window k, from the beliefs given."""
        if k in self._beliefs:
            belief = _select(which, belief, self._beliefs[k])
        self._beliefs[k] = belief
        self.window[which] = k


@jax.jit
def _select(which: jax.Array, yes: Belief, no: Belief) -> Belief:
    return jax.tree.map(
        lambda a, b: jnp.where(jnp.expand_dims(which, range(1, a.ndim)), a, b), yes, no
    )


@partial(jax.jit, static_argnames="window")
def _resize(records: Records, belief: Belief, window: int | None) -> Belief:
    fresh = belief._replace(dropped=jnp.full_like(belief.dropped, NOTHING))
    return jax.vmap(lambda one: resize(records, one, window))(fresh)
