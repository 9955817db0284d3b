"""The closed loop: the filter drives the plane. The only room where both meet."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter import Belief, build_filter
from jaxreplay.params import Params
from jaxreplay.plane.world import Plane
from jaxreplay.records import Records
from jaxreplay.window import resize

COMPLETED = 0.9  # § 2.2.5
CHUNK = 7  # replays that advance in one call of the filter
WINDOWS = (64, 128, 256, None)  # moments of each record held; None is all
DROP_TOLERANCE = 1e-9  # share of a belief that a step may drop at its window's edges
NARROW_EVERY = 16  # control steps
OUTCOMES = ("S", "Fs", "Fg", "Fb")  # as in figure 3


class Replays(NamedTuple):
    """What B replays came to.

    Attributes:
        outcome: `[B]` S (cube held and lifted when the replay ended), Fs (not ended within the
            time limit), Fg (ended without the cube) or Fb (left the area).
        alignment_error: `[B]` lateral distance between the magnet's centre and the centre of
            the face it took hold of, mm; NaN unless S.
        duration: `[B]` s.
        log_evidence: `[B]` log p(Z_1:t) of the whole replay.
        widened: how often a step was done again in a wider window.
    """

    outcome: np.ndarray
    alignment_error: np.ndarray
    duration: np.ndarray
    log_evidence: np.ndarray
    widened: int


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
            belief, log_evidence = filter.update(records, params, belief, z)
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


class _Chunk:
    """Replays whose beliefs are held in windows of one width, and advance in one call.

    No step drops more than `DROP_TOLERANCE` of a belief: one that would is done again in a
    wider window, from the belief before it. A narrower one is tried again every so often.
    """

    def __init__(self, records: Records, params: Params, jump: str):
        self.records, self.params, self.jump = records, params, jump
        self.window = WINDOWS[0]
        self.widened = 0
        self._belief, command = _steps(jump, self.window).begin(records, params)
        self.command = np.asarray(command)

    def advance(self, z: np.ndarray, going: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take in observations; the log evidence gained and p(the end is reached), `[B]`."""
        while True:
            belief, command, gained, ended = _steps(self.jump, self.window).advance(
                self.records, self.params, self._belief, z, going
            )
            if self.window is None or self._dropped(belief, going) <= DROP_TOLERANCE:
                break
            self._resize(WINDOWS[WINDOWS.index(self.window) + 1])
            self.widened += 1
        self._belief, self.command = belief, np.asarray(command)
        return np.asarray(gained), np.asarray(ended)

    def narrow(self, going: np.ndarray):
        """Take the next narrower window if little enough is lost by it."""
        if self.window == WINDOWS[0]:
            return
        held = self._belief, self.window
        self._resize(WINDOWS[WINDOWS.index(self.window) - 1])
        if self._dropped(self._belief, going) > DROP_TOLERANCE / 10:
            self._belief, self.window = held

    def _resize(self, window: int | None):
        self._belief = _resize(self.records, self._belief, window)
        self.window = window

    def _dropped(self, belief: Belief, going: np.ndarray) -> float:
        return np.max(np.asarray(belief.dropped), where=going, initial=0.0)


@partial(jax.jit, static_argnames="window")
def _resize(records: Records, belief: Belief, window: int | None) -> Belief:
    return jax.vmap(lambda one: resize(records, one, window))(belief)


def replay(
    records: Records,
    params: Params,
    plane: Plane,
    jump: str,
    progress: Callable[[int, np.ndarray], None] = lambda step, outcome: None,
) -> Replays:
    """Replay the records in every world of a plane, all advancing together.

    Args:
        records: demonstrations of the plane's 7 sensors and 5 commands.
        params: `[B]`-batched parameters.
        plane: B fresh worlds.
        jump: `"same_tau"` or `"own_tau"`.
        progress: called after every control step with its number and the outcomes so far
            (empty strings for replays that go on).
    """
    p, n = plane.params, len(plane.state.robot)
    outcome = np.full(n, "", dtype="<U2")
    duration = np.full(n, np.nan)
    # Chunks of one size, so that one program serves all; the last is filled up with replays that
    # never go on.
    parts = [slice(i, i + CHUNK) for i in range(0, n, CHUNK)]
    m = parts[-1].stop
    going = np.zeros(m, dtype=bool)
    z = np.zeros((m, records.n_sensors), dtype=records.nodes.dtype)
    log_evidence, ended = np.zeros(m), np.zeros(m)
    lanes = jax.tree.map(lambda x: x[np.minimum(np.arange(m), n - 1)], params)
    chunks = [_Chunk(records, jax.tree.map(lambda x, s=s: x[s], lanes), jump) for s in parts]

    def advance(chunk: _Chunk, part: slice):
        if going[part].any():
            gained, ended[part] = chunk.advance(z[part], going[part])
            log_evidence[part] += gained
            if step % NARROW_EVERY == 0:
                chunk.narrow(going[part])

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for step in range(1, p.max_steps + 1):
            going[:n] = outcome == ""
            commands = np.concatenate([chunk.command for chunk in chunks])[:n]
            z[:n] = plane.step(commands, going[:n])
            list(threads.map(advance, chunks, parts))

            completed = ended[:n] > COMPLETED
            for name, is_so in (
                ("Fb", plane.outside),
                ("S", completed & plane.lifted),
                ("Fg", completed),
                ("Fs", np.full(n, step == p.max_steps)),
            ):
                outcome[(outcome == "") & is_so] = name
            duration[going[:n]] = step * p.control_period
            progress(step, outcome)
            if (outcome != "").all():
                break
    error = np.where(outcome == "S", 1e3 * plane.alignment_error, np.nan)
    widened = sum(chunk.widened for chunk in chunks)
    return Replays(outcome, error, duration, log_evidence[:n], widened)
