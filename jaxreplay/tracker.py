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
from jaxreplay.window import resize

WINDOWS = (64, 128, 256, None)  # moments of each record held; None is all
NARROW_EVERY = 16  # steps
DROP_TOLERANCE = 1e-9  # share of a belief that a step may drop at its window's edges


class _Steps(NamedTuple):
    """The filter's side of a control step, for a chunk of replays."""

    begin: Callable  # (records, params) → belief, command
    advance: Callable  # (records, params, belief, z, going) → belief, command, evidence, p(end)


@cache
def _steps(jump: str, window: int | None) -> _Steps:
    filter = build_filter(jump, window)

    def predict(records: Records, params: Params, belief: Belief):
        belief = filter.predict(records, params, belief)
        return belief, filter.command(records, belief)

    def begin(records, params):
        return jax.lax.map(lambda one: predict(records, one, filter.init(records)), params)

    def advance(records, params, belief, z, going):
        def step(params, belief, z):
            belief = belief._replace(dropped=jnp.zeros_like(belief.dropped))
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

    return _Steps(jax.jit(begin), jax.jit(advance))


class Tracker:
    """B replays whose beliefs are held in windows of one width, and advance in one call.

    A belief is kept as predicted, with the command that follows from it ready to be sent.
    No step drops more than `DROP_TOLERANCE` of a belief: one that would is done again in a
    wider window, from the belief before it. A narrower one is tried again every so often.
    """

    def __init__(self, records: Records, params: Params, jump: str):
        """Start B replays.

        Args:
            records: N records.
            params: `[B]`-batched parameters.
            jump: `"same_tau"` or `"own_tau"`.
        """
        self.records, self.params, self.jump = records, params, jump
        self.restart()

    def restart(self):
        """Begin again at the records' first samples."""
        self.window = WINDOWS[0]
        self.widened = self._taken = 0
        self.belief, command = _steps(self.jump, self.window).begin(self.records, self.params)
        self.command = np.asarray(command)

    def advance(self, z: np.ndarray, going: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take in observations, and predict.

        Args:
            z: `[B, n_s]` Z_t.
            going: `[B]` which replays go on; the others rest.

        Returns:
            The log evidence gained and p(the end is reached), each `[B]`.
        """
        z = self.records.centre(z)
        while True:
            belief, command, gained, ended = _steps(self.jump, self.window).advance(
                self.records, self.params, self.belief, z, going
            )
            if self.window is None or _dropped(belief, going) <= DROP_TOLERANCE:
                break
            self.resize(WINDOWS[WINDOWS.index(self.window) + 1])
            self.widened += 1
        self.belief, self.command = belief, np.asarray(command)
        self._taken += 1
        if self._taken % NARROW_EVERY == 0 and self.window != WINDOWS[0]:
            held = self.belief, self.window
            self.resize(WINDOWS[WINDOWS.index(self.window) - 1])
            if _dropped(self.belief, going) > DROP_TOLERANCE / 10:
                self.belief, self.window = held
        return np.asarray(gained), np.asarray(ended)

    def resize(self, window: int | None):
        """Bring the beliefs to another window, wider or narrower."""
        self.belief = _resize(self.records, self.belief, window)
        self.window = window


def _dropped(belief: Belief, going: np.ndarray) -> float:
    return np.max(np.asarray(belief.dropped), where=going, initial=0.0)


@partial(jax.jit, static_argnames="window")
def _resize(records: Records, belief: Belief, window: int | None) -> Belief:
    fresh = belief._replace(dropped=jnp.zeros_like(belief.dropped))
    return jax.vmap(lambda one: resize(records, one, window))(fresh)
