"""Replays tracked together: the steps of the filter compiled as one, in windows that fit."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter import Belief, build_filter, update
from jaxreplay.machine import cores
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.scaled import LOWEST
from jaxreplay.window import NOTHING, resize

# Moments of each record held, if not all.
WINDOWS = (128, 256, 384, 512, 768, 1152, 1728, 2592, 3888)
LANES = 28  # replays that are advanced in one call, so that one program serves all
NARROW_EVERY = 32  # steps
# A step may drop a hypothesis at its window's edges that is so far behind that this many
# observations could not bring it back, even if each told the records' most distant samples apart.
RETURN_AFTER = 24
MARGIN = 200  # bits that it must be behind besides, for records that hardly differ
# Processors with registers of 512 bits gain a quarter; XLA uses half of them by default.
COMPILER_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


class Steps(NamedTuple):
    """The filter's side of a control step, for some of the B replays in windows of one width.

    All take the beliefs of B replays and which of them to work on: `[B]` indices, of which the
    first n count. They return the beliefs, in the place of those given, and `[B, …]` results.
    """

    begin: Callable  # (records, params, beliefs, which, n) → beliefs, command
    advance: Callable  # (records, params, beliefs, which, n, z, droppable) → beliefs, Taken
    move: Callable  # (records, source beliefs, beliefs, which, n) → beliefs, dropped


class Taken(NamedTuple):
    """What a step came to, each `[B, …]`; of one that dropped too much, nothing was kept."""

    command: jax.Array
    log_evidence: jax.Array
    end_probability: jax.Array
    dropped: jax.Array


@cache
def steps(jump: str, window: int | None) -> Steps:
    """The filter's steps, compiled for windows of one width."""
    filter = build_filter(jump, window)

    def begin(records, params, beliefs, which, n):
        def one(b, belief):
            belief = filter.predict(records, _lane(params, b), filter.init(records))
            return belief, filter.command(records, belief)

        return _each(one, beliefs, which, n)

    def advance(records, params, beliefs, which, n, z, droppable):
        def one(b, before):
            belief = before._replace(dropped=jnp.asarray(NOTHING, jnp.int32))
            belief, log_evidence = update(records, _lane(params, b), belief, z[b])
            ended = filter.end_probability(records, belief)
            belief = filter.predict(records, _lane(params, b), belief)
            taken = Taken(filter.command(records, belief), log_evidence, ended, belief.dropped)
            too_much = belief.dropped > droppable[b]
            return jax.tree.map(lambda x, y: jnp.where(too_much, x, y), before, belief), taken

        return _each(one, beliefs, which, n)

    def move(records, source, beliefs, which, n):
        def one(b, _):
            fresh = _lane(source, b)._replace(dropped=jnp.asarray(NOTHING, jnp.int32))
            belief = resize(records, fresh, window)
            return belief, belief.dropped

        return _each(one, beliefs, which, n)

    return Steps(
        jax.jit(begin, donate_argnums=2),
        jax.jit(advance, donate_argnums=2, compiler_options=COMPILER_OPTIONS),
        jax.jit(move, donate_argnums=2),
    )


def _lane(batch, b: jax.Array):
    return jax.tree.map(lambda x: x[b], batch)


_lane_of = jax.jit(_lane)


def _each(one: Callable, beliefs: Belief, which: jax.Array, n: jax.Array):
    """One replay after the other, so that what it needs stays in the processor's cache."""
    shapes = jax.eval_shape(one, which[0], _lane(beliefs, which[0]))[1]
    results = jax.tree.map(lambda x: jnp.zeros((len(which), *x.shape), x.dtype), shapes)

    def body(k, held):
        b = which[k]
        return jax.tree.map(lambda x, new: x.at[b].set(new), held, one(b, _lane(held[0], b)))

    return jax.lax.fori_loop(0, n, body, (beliefs, results))


def windows_for(records: Records, windows: Sequence[int] | None = None) -> tuple[int | None, ...]:
    """The windows, `WINDOWS` if None, that are narrower than the records, and None for all."""
    widths = WINDOWS if windows is None else windows
    return (*(w for w in widths if w < records.longest), None)


class Tracker:
    """B replays that advance together, each belief in a window of its own width.

    A belief is kept as predicted, with the command that follows from it ready to be sent.
    No step drops a hypothesis likelier than 2^`droppable`: one that would is done again in a
    wider window, from the belief before it. A narrower one is tried again every so often.
    What becomes of a replay does not depend on those beside it.

    What was dropped may be missed later: after hundreds of observations at one place, a robot
    that is carried back to where it was long before is not found there by a narrow window.

    Attributes:
        command: `[B, n_u]` to be sent next.
        window: `[B]` which of the windows each replay is in.
        widened: `[B]` how often a step was done again, since the replay began.
        dropped: `[B]` log2 of the likeliest hypothesis dropped since then; −inf for none.
        droppable: `[B]` bits; follows from σ.
    """

    def __init__(
        self,
        records: Records,
        params: Params,
        jump: str,
        windows: Sequence[int] | None = None,
    ):
        """Start B replays.

        Args:
            records: N records.
            params: `[B]`-batched parameters.
            jump: `"same_tau"` or `"own_tau"`.
            windows: widths to choose from, ascending, besides all moments; `WINDOWS` if None.
        """
        self.records, self.params, self.jump = records, params, jump
        self.windows = windows_for(records, windows)
        n = len(params.theta_i)
        self.command = np.zeros((n, records.n_commands))
        self.window, self.widened, self._taken = np.zeros((3, n), int)
        self.dropped = np.full(n, -np.inf)
        self._beliefs = [None] * len(self.windows)  # a replay's is where its window says
        self.restart(np.ones(n, bool), params)

    def restart(self, which: np.ndarray, params: Params):
        """Begin again at the records' first samples, in the replays `[B]` told.

        Args:
            which: `[B]` replays.
            params: `[B]`-batched parameters of all replays from here on.
        """
        self.params = params
        low, high = np.asarray(self.records.span, float)
        told = np.sum(((high - low) / params.sigma) ** 2, axis=1) / (2 * np.log(2))
        self.droppable = np.maximum(-RETURN_AFTER * told - MARGIN, LOWEST - 1).astype(np.int32)
        command = self._do(0, "begin", which, params)
        self.command[which] = np.asarray(command)[which]
        self.window[which] = self.widened[which] = self._taken[which] = 0
        self.dropped[which] = -np.inf

    def advance(self, z: np.ndarray, going: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take in observations, and predict.

        Args:
            z: `[B, n_s]` Z_t.
            going: `[B]` which replays go on; the others rest.

        Returns:
            The log evidence gained and p(the end is reached), each `[B]`, 0 for those that rest.
        """
        z = self.records.centre(z)
        gained, ended = np.zeros((2, len(going)))
        last = len(self.windows) - 1
        for k in range(last + 1):
            now = going & (self.window == k)
            if not now.any():
                continue
            taken = Taken(
                *map(np.asarray, self._do(k, "advance", now, self.params, z, self.droppable))
            )
            if k < last and (lossy := now & (taken.dropped > self.droppable)).any():
                self._do(k + 1, "move", lossy, self._beliefs[k])
                self.window[lossy] += 1  # its turn is next
                self.widened[lossy] += 1
                now &= ~lossy
            self._lost(now, taken.dropped)
            self.command[now] = taken.command[now]
            gained[now], ended[now] = taken.log_evidence[now], taken.end_probability[now]
        self._taken[going] += 1
        self._narrow(going & (self._taken % NARROW_EVERY == 0))
        return gained, ended

    def belief(self, b: int) -> Belief:
        """Of one replay, as predicted for the next step."""
        return _lane_of(self._beliefs[self.window[b]], b)

    def compile(self):
        """Compile all that may be needed, so that no step waits for it."""
        z = self.records.centre(np.zeros((len(self.window), self.records.n_sensors)))
        nobody = self.window < 0
        last = len(self.windows) - 1

        def compile_for(k: int):
            _lane_of(self._room(k), 0)
            self._call(k, "advance", self._room(k), nobody, self.params, z, self.droppable)
            for neighbour in {max(k - 1, 0), min(k + 1, last)} - {k}:
                self._call(k, "move", self._room(k), nobody, self._room(neighbour))

        self._call(0, "begin", self._room(0), nobody, self.params)
        with ThreadPoolExecutor(cores()) as threads:
            list(threads.map(compile_for, range(last + 1)))

    def _narrow(self, which: np.ndarray):
        for k in range(1, len(self.windows)):
            now = which & (self.window == k)
            if now.any():
                dropped = np.asarray(self._do(k - 1, "move", now, self._beliefs[k]))
                now &= dropped <= self.droppable - 4
                self.window[now] -= 1
                self._lost(now, dropped)

    def _lost(self, which: np.ndarray, bits: np.ndarray):
        bits = np.where(bits > NOTHING, bits, -np.inf)
        self.dropped[which] = np.maximum(self.dropped, bits)[which]

    def _do(self, k: int, what: str, which: np.ndarray, *args):
        """Take one of the steps in windows k, for the replays told; the results."""
        if self._beliefs[k] is None:
            self._beliefs[k] = self._room(k)
        self._beliefs[k], results = self._call(k, what, self._beliefs[k], which, *args)
        return results

    def _call(self, k: int, what: str, beliefs: Belief, which: np.ndarray, first, *rest):
        step = getattr(steps(self.jump, self.windows[k]), what)
        chosen = np.argsort(~which, kind="stable").astype(np.int32)
        return step(self.records, first, beliefs, chosen, which.sum(), *rest)

    def _room(self, k: int) -> Belief:
        """For the beliefs of all replays in windows k."""
        filter = build_filter(self.jump, self.windows[k])
        shapes = jax.eval_shape(filter.init, self.records)
        return jax.tree.map(lambda x: jnp.zeros((len(self.window), *x.shape), x.dtype), shapes)
