"""Many replays tracked together, each belief in a window that fits it."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter import build_filter
from jaxreplay.filter.belief import NOTHING_DROPPED, Belief
from jaxreplay.filter.numerics.scaled import LOWEST
from jaxreplay.filter.options import Options, Start
from jaxreplay.loop.lanes import Steps, lane, results_of, steps
from jaxreplay.machine import cores
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.records.columns import command_range

# Widths of windows to choose from, in samples of a record, besides all samples. With twice as many
# widths a study took as long: replays of each width are a call of their own.
WINDOWS = (192, 320, 448, 672, 1088, 1760, 2848, 4608)
# Replays that are advanced in one call, so that one compiled program serves all: two calls, one on
# each of two cores, advance the 56 slots that a study has by default.
LANES = 28
NARROW_EVERY = 32  # steps after which a narrower window is tried
# A window may drop a hypothesis only if it is so improbable that this many observations could not
# make it win again, even if each favoured it by as much as the records' range allows (for
# observations inside that range), … Of 300 replays in the default world one had a command changed
# by 2e-4 of its range with 8, by 5e-5 with 10, and by 2e-6 with 12.
RETURN_AFTER = 12
MARGIN = 200  # … and by this many bits more, for records that hardly differ
# A narrower window is taken only if what it drops is this many bits below the limit: else it would
# soon be widened again.
NARROW_MARGIN = 4

_lane_of = jax.jit(lane)


def windows_for(records: Records, windows: Sequence[int] | None = None) -> tuple[int | None, ...]:
    """Return the windows narrower than the records, and None, which stores all samples.

    Args:
        records: the records.
        windows: widths in ascending order; `WINDOWS` if None.
    """
    widths = WINDOWS if windows is None else windows
    return (*(w for w in widths if w < records.longest), None)


class Tracker:
    """Tracks B replays that advance together, each belief in a window of its own width.

    Between steps a belief is the predicted one, and its command is ready to be sent. No step drops
    a hypothesis more probable than 2^`droppable` (under `own_tau`: more probable than that share of
    its record's most probable sample). A step that would is computed again in a wider window, from
    the belief before it. Every 32 steps a narrower window is tried. Results of a replay do not
    depend on the replays beside it.

    A dropped hypothesis may be missed later: a robot that stands still for hundreds of steps and is
    then carried back to where it was long before is not found there by a narrow window.

    Attributes:
        command: `[B, n_u]` the commands to send next: equation 8, clipped to the range that each
            command has in the records, which rounding exceeds by some 1e-7.
        window: `[B]` index of the window that each replay is in.
        widened: `[B]` times that a step was computed again in a wider window since the replay
            began.
        dropped: `[B]` log2 of the probability of the most probable hypothesis dropped since then
            (see `Belief.dropped`); −∞ for none.
        droppable: `[B]` limit on `dropped` (a log2 probability, int32), from σ and the sensors'
            ranges.
    """

    def __init__(
        self,
        records: Records,
        params: Params,
        options: Options,
        windows: Sequence[int] | None = None,
    ):
        """Begin B replays.

        Args:
            records: N records.
            params: `[B]`-batched parameters.
            options: reading of a jump, start, and what counts as a record's end.
            windows: widths in ascending order, to choose from besides all samples; `WINDOWS` if
                None.
        """
        self.records, self.params = records, params
        self.options = options
        self.windows = windows_for(records, windows)
        self._centred = records.centred()
        self._last_steps = np.int32(options.counted)
        self._lowest, self._highest = command_range(records.commands, records.lengths)
        n = len(params.theta_i)
        self.command = np.zeros((n, records.n_commands))
        self.window, self.widened, self._observed = np.zeros((3, n), int)
        self.dropped = np.full(n, -np.inf)
        # For each window the beliefs of all replays; that of a replay is valid in its own window.
        self._beliefs: list[Belief | None] = [None] * len(self.windows)
        self.begin(np.ones(n, bool), params)

    def start_from(self, start: Start) -> None:
        """Let replays that begin from now on start there."""
        self.options = self.options._replace(start=start)

    def begin(self, which: np.ndarray, params: Params) -> None:
        """Begin replays where they start, see :class:`jaxreplay.filter.options.Options`.

        Args:
            which: `[B]` bool, the replays that begin; the others go on.
            params: `[B]`-batched parameters of all replays from now on.
        """
        self.params = params
        low, high = np.asarray(self.records.span, float)
        most = np.sum(((high - low)[None] / params.sigma) ** 2, axis=1) / (2 * np.log(2))
        # LOWEST − 1 is below the exponent of every probability but 0: then only 0 may be dropped.
        limit = np.maximum(-RETURN_AFTER * most - MARGIN, LOWEST - 1)
        self.droppable = limit.astype(np.int32)
        self._params = jax.tree.map(jnp.asarray, params)  # copied to the device once
        # A start anywhere needs all samples, which the last of the windows stores.
        k = 0 if self.options.start == "first" else len(self.windows) - 1
        begin = self._steps(k).begin
        self._beliefs[k] = begin(
            self._centred, self._stored_beliefs(k), _chosen(which), self.options.start
        )
        self.window[which] = k
        self.observe(np.full((len(which), self.records.n_sensors), np.nan), which)
        self.widened[which] = self._observed[which] = 0
        self.dropped[which] = -np.inf

    def observe(self, z: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, ...]:
        """Update beliefs with an observation each, and predict.

        Args:
            z: `[B, n_s]` Z_t in the sensors' units; NaN marks a missing sensor.
            which: `[B]` bool, the replays that observe; the others stay as they are.

        Returns:
            log p(Z_t | Z_{1:t−1}), p(τ in the last samples), and the distance from Z_t to the most
            probable state (see :mod:`jaxreplay.filter.distance`), each `[B]`; 0 for the others.
        """
        z = np.asarray(self.records.centre(z))
        log_evidence, end_probability, distance = np.zeros((3, len(which)))
        last, limits = len(self.windows) - 1, (self.droppable, self._last_steps)
        for k in range(last + 1):
            now = which & (self.window == k)
            if not now.any():
                continue
            step = self._steps(k).observe
            results = results_of(self._run(k, step, now, self._params, z, *limits))
            lossy = now & (results.too_much > 0)
            if k < last and lossy.any():
                self._run(k + 1, self._steps(k + 1).move, lossy, self._beliefs[k])
                self.window[lossy] += 1  # the loop comes to it next
                self.widened[lossy] += 1
                now &= ~lossy
            self._record_dropped(now, results.dropped)
            self.command[now] = np.clip(results.command[now], self._lowest, self._highest)
            log_evidence[now] = results.log_evidence[now]
            end_probability[now] = results.end_probability[now]
            distance[now] = results.distance[now]
        self._observed[which] += 1
        self._narrow(which & (self._observed % NARROW_EVERY == 0))
        return log_evidence, end_probability, distance

    def belief(self, b: int) -> Belief:
        """Return the belief of replay b, as predicted for its next step."""
        return _lane_of(self._beliefs[self.window[b]], b)

    def compile(self) -> None:
        """Compile every program that may be needed, so that no step waits for it."""
        z = np.asarray(self.records.centre(np.zeros((len(self.window), self.records.n_sensors))))
        nobody = np.zeros(len(self.window), bool)
        last = len(self.windows) - 1

        def compile_for(k: int) -> None:
            _lane_of(self._empty_beliefs(k), 0)
            compiled = self._steps(k)
            self._call(
                compiled.observe, self._empty_beliefs(k), nobody, self._params, z, self.droppable,
                self._last_steps,
            )  # fmt: skip
            for neighbour in {max(k - 1, 0), min(k + 1, last)} - {k}:
                self._call(
                    compiled.move, self._empty_beliefs(k), nobody, self._empty_beliefs(neighbour)
                )

        with ThreadPoolExecutor(cores()) as threads:
            list(threads.map(compile_for, range(last + 1)))

    def _narrow(self, which: np.ndarray) -> None:
        for k in range(1, len(self.windows)):
            now = which & (self.window == k)
            if now.any():
                move = self._steps(k - 1).move
                dropped = np.asarray(self._run(k - 1, move, now, self._beliefs[k]))
                now &= dropped <= self.droppable - NARROW_MARGIN
                self.window[now] -= 1
                self._record_dropped(now, dropped)

    def _record_dropped(self, which: np.ndarray, bits: np.ndarray) -> None:
        bits = np.where(bits > NOTHING_DROPPED, bits, -np.inf)
        self.dropped[which] = np.maximum(self.dropped, bits)[which]

    def _steps(self, k: int) -> Steps:
        return steps(self.options.jump, self.windows[k])

    def _run(self, k: int, step: Any, which: np.ndarray, first: Any, *rest: Any) -> Any:
        """Run a step on beliefs in window k, for the replays in `which`; return its results.

        `first` is what a step takes before the beliefs: params, or for `move` the source.
        """
        beliefs = self._stored_beliefs(k)
        self._beliefs[k], results = self._call(step, beliefs, which, first, *rest)
        return results

    def _call(self, step: Any, beliefs: Belief, which: np.ndarray, first: Any, *rest: Any) -> Any:
        return step(self._centred, first, beliefs, _chosen(which), *rest)

    def _stored_beliefs(self, k: int) -> Belief:
        """Return the beliefs in window k; before the first, memory for them."""
        beliefs = self._beliefs[k]
        return self._empty_beliefs(k) if beliefs is None else beliefs

    def _empty_beliefs(self, k: int) -> Belief:
        """Return memory for the beliefs of all replays in window k."""
        init = build_filter(self.options.jump, self.windows[k]).init
        shapes = jax.eval_shape(init, self._centred)
        return jax.tree.map(lambda x: jnp.zeros((len(self.window), *x.shape), x.dtype), shapes)


def _chosen(which: np.ndarray) -> np.ndarray:
    """Return the indices of the replays in `which`, filled up to B with B."""
    chosen = np.full(len(which), len(which), np.int32)
    chosen[: which.sum()] = np.flatnonzero(which)
    return chosen
