"""The closed loop (§ 2.3): the filter drives an environment."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import gymnasium
import jax
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from jaxreplay.filter.belief import DEFAULT_JUMP, Jump
from jaxreplay.loop.tracker import LANES, Tracker
from jaxreplay.machine import cores
from jaxreplay.params import Params
from jaxreplay.records import Records

COMPLETED = 0.9  # § 2.2.5

MakeTracker = Callable[[Records, Params, Jump], Any]


class Replays(NamedTuple):
    """Results of n replays.

    Attributes:
        ending: `[n]` how each ended: "terminated" (by the environment), else "completed" (the
            belief reached the records' end), else "truncated" (by the environment); empty while
            it runs.
        steps: `[n]` control steps taken.
        reward: `[n]` sum of the environment's rewards.
        log_evidence: `[n]` log p(Z_1:t) of the replay.
        info: the environment's info of each replay's last step, `[n, …]` by name; where it gave
            none: NaN for floats, else 0, False or an empty string.
        widened: `[n]` times that a step was computed again in a wider window.
        dropped: `[n]` log2 of the probability of the most probable hypothesis that windows
            dropped (see `Belief.dropped`); −∞ for none.
        observations: of each replay asked for, a list of its `[n_s]` Z_t.
    """

    ending: np.ndarray
    steps: np.ndarray
    reward: np.ndarray
    log_evidence: np.ndarray
    info: dict[str, np.ndarray]
    widened: np.ndarray
    dropped: np.ndarray
    observations: dict[int, list[np.ndarray]]


def replay(
    records: Records,
    params: Params,
    env: VectorEnv,
    seeds: Sequence[int],
    *,
    jump: Jump = DEFAULT_JUMP,
    options: Mapping[str, np.ndarray] | None = None,
    keep: Sequence[int] = (),
    progress: Callable[[Replays], None] = lambda so_far: None,
    tracker: MakeTracker = Tracker,
) -> Replays:
    """Replay the records n times in the B slots of an environment.

    A slot is a sub-environment of `env`; it has one replay at a time. All slots advance together,
    and a slot whose replay has ended is given the next. A replay is complete when p(τ in the last
    10 samples) exceeds 0.9 (§ 2.2.5). So it may end up to 10 samples before its records do: let
    them go on for 10 samples after the goal is reached.

    Args:
        records: demonstrations of the environment's observations and actions.
        params: `[n]`-batched parameters.
        env: any Gymnasium vector environment with Box observations and actions whose autoreset
            is disabled. If it has an attribute `resting` (`[B]` bool), slots whose replay has ended
            are set True there, and the environment may skip them; its reset sets them False.
        seeds: n seeds, one for each replay.
        jump: `"same_tau"` or `"own_tau"`.
        options: for the environment's reset, `[n, …]` by name; the environment receives those of
            its slots, `[B, …]`, and `reset_mask`, `[B]` bool, the slots to reset. (Gymnasium's own
            SyncVectorEnv passes the whole `[B, …]` arrays to each sub-environment.)
        keep: replays whose observations are returned.
        progress: called with the results so far after every control step.
        tracker: constructor of the filter of `LANES` slots, called as `tracker(records, params,
            jump)`; its result needs `begin`, `observe`, `command`, `widened` and `dropped` as in
            :class:`Tracker`. Another than the default serves to compare filters.

    Raises:
        ValueError: environment and records do not fit each other, or its autoreset is enabled.
    """
    _check(records, env)
    with ThreadPoolExecutor(cores()) as threads:
        loop = _Loop(records, params, env, seeds, jump, options or {}, keep, tracker, threads)
        loop.start(np.ones(env.num_envs, bool))
        while loop.going.any():
            result = loop.step(loop.trackers.command)
            loop.observe(result)
            loop.start(loop.end(result))
            progress(loop.replays)
    return loop.replays


class _StepResult(NamedTuple):
    """What `env.step` returns, each `[B, …]`."""

    observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    info: dict[str, Any]


class _Trackers:
    """Trackers for B slots, `LANES` slots each, stepped in threads.

    All have `LANES` lanes, so that the same compiled programs serve. The last may have lanes
    without a slot; these never observe.
    """

    def __init__(self, records, params, slots: int, jump: Jump, make: MakeTracker, threads):
        self._parts = [slice(i, i + LANES) for i in range(0, slots, LANES)]
        self._slots, self._lanes, self._threads = slots, self._parts[-1].stop, threads
        first = np.zeros(LANES, int)
        self._each = [make(records, _of(params, first), jump) for _ in self._parts]

    def begin(self, which: np.ndarray, params: Params, replay_in_slot: np.ndarray) -> None:
        """Begin the replays `replay_in_slot` in the slots `which` (`[B]` ints, `[B]` bool)."""
        which, replays = self._padded(which), self._padded(replay_in_slot)
        for tracker, part in zip(self._each, self._parts, strict=True):
            if which[part].any():
                tracker.begin(which[part], _of(params, replays[part]))

    def observe(self, z: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Update the slots `which`, `[B]` bool, with z `[B, n_s]`; return as :class:`Tracker`."""
        z, which = self._padded(z), self._padded(which)
        results = np.zeros((2, self._lanes))

        def one(tracker: Tracker, part: slice) -> None:
            if which[part].any():
                results[:, part] = tracker.observe(z[part], which[part])

        list(self._threads.map(one, self._each, self._parts))
        log_evidence, end_probability = results[:, : self._slots]
        return log_evidence, end_probability

    @property
    def command(self) -> np.ndarray:
        """`[B, n_u]` the commands to send next."""
        return self._joined([tracker.command for tracker in self._each])

    @property
    def widened(self) -> np.ndarray:
        """`[B]`, as in :class:`Tracker`."""
        return self._joined([tracker.widened for tracker in self._each])

    @property
    def dropped(self) -> np.ndarray:
        """`[B]`, as in :class:`Tracker`."""
        return self._joined([tracker.dropped for tracker in self._each])

    def _joined(self, values: list[np.ndarray]) -> np.ndarray:
        return np.concatenate(values)[: self._slots]

    def _padded(self, values: np.ndarray) -> np.ndarray:
        more = [(0, self._lanes - self._slots)] + [(0, 0)] * (values.ndim - 1)
        return np.pad(values, more)


class _Loop:
    """The state of :func:`replay`: which replay each slot has, and the results so far."""

    def __init__(self, records, params, env, seeds, jump, options, keep, tracker, threads):
        n, slots = len(seeds), env.num_envs
        self.env, self.params, self.seeds, self.options = env, params, seeds, options
        self.replay_in_slot = np.zeros(slots, int)  # indices of replays
        self.going = np.zeros(slots, bool)  # slots whose replay has not ended
        self.started = 0  # replays given to a slot so far
        self.over = np.zeros(slots, bool)  # slots to be reset before they can be stepped again
        self.trackers = _Trackers(records, params, slots, jump, tracker, threads)
        self.replays = Replays(
            ending=np.full(n, "", dtype="<U10"),
            steps=np.zeros(n, int),
            reward=np.zeros(n),
            log_evidence=np.zeros(n),
            info={},
            widened=np.zeros(n, int),
            dropped=np.full(n, -np.inf),
            observations={k: [] for k in keep},
        )

    def start(self, free: np.ndarray) -> None:
        """Give the next replays to free slots, `[B]` bool: reset these and begin their beliefs."""
        slots = len(free)
        take = np.flatnonzero(free)[: len(self.seeds) - self.started]
        nothing_started = self.started == 0
        self.replay_in_slot[take] = np.arange(self.started, self.started + len(take))
        self.going[take] = True
        self.started += len(take)
        taken = np.isin(np.arange(slots), take)
        # At first every slot; later those that take a replay, and those that are over without one:
        # these cannot be stepped any more.
        fresh = free if nothing_started else taken | (self.over & ~self.going)
        if not fresh.any():
            return
        options = {
            name: np.asarray(value)[self.replay_in_slot] for name, value in self.options.items()
        }
        seeds = [
            self.seeds[self.replay_in_slot[b]] if self.going[b] else None for b in range(slots)
        ]
        self.env.reset(seed=seeds, options=options | {"reset_mask": fresh.copy()})
        self.trackers.begin(taken, self.params, self.replay_in_slot)

    def step(self, command: np.ndarray) -> _StepResult:
        """Send commands `[B, n_u]`; return what the environment gives back."""
        return _StepResult(*self.env.step(command.astype(self.env.single_action_space.dtype)))

    def observe(self, result: _StepResult) -> None:
        """Update beliefs with the observations, and the results with what is known now."""
        going, now, replays = self.going, self.replay_in_slot[self.going], self.replays
        z = np.asarray(result.observation, float)
        log_evidence, self.end_probability = self.trackers.observe(z, going)
        for b in np.flatnonzero(going):
            if self.replay_in_slot[b] in replays.observations:
                replays.observations[self.replay_in_slot[b]].append(z[b].copy())
        replays.steps[now] += 1
        replays.widened[now] = self.trackers.widened[going]
        replays.dropped[now] = self.trackers.dropped[going]
        replays.reward[now] += result.reward[going]
        replays.log_evidence[now] += log_evidence[going]

    def end(self, result: _StepResult) -> np.ndarray:
        """Note which replays ended, and how; return their slots, `[B]` bool."""
        before = self.going.copy()
        for ending, is_so in (
            ("terminated", result.terminated),
            ("completed", self.end_probability > COMPLETED),
            ("truncated", result.truncated),
        ):
            ends = is_so & self.going
            self.replays.ending[self.replay_in_slot[ends]] = ending
            self.going[ends] = False
        ended = before & ~self.going
        if ended.any():
            _keep_info(self.replays.info, result.info, self.replay_in_slot, ended, len(self.seeds))
        if hasattr(self.env, "resting"):
            self.env.resting[ended] = True
        else:
            self.over = result.terminated | result.truncated
        return ended


def _of(params: Params, replays: np.ndarray) -> Params:
    return jax.tree.map(lambda x: x[replays], params)


def _keep_info(
    kept: dict[str, np.ndarray],
    info: dict[str, Any],
    replay_in_slot: np.ndarray,
    ended: np.ndarray,
    n: int,
) -> None:
    """Copy the info of slots that ended, where it is an array, to the results of their replays."""
    for name, value in info.items():
        if name.startswith("_") or not isinstance(value, np.ndarray):
            continue
        if name not in kept:
            missing = np.nan if value.dtype.kind == "f" else value.dtype.type()
            kept[name] = np.full((n, *value.shape[1:]), missing, value.dtype)
        given = ended & info.get(f"_{name}", True)
        kept[name][replay_in_slot[given]] = value[given]


def _check(records: Records, env: VectorEnv) -> None:
    mode = env.metadata.get("autoreset_mode")
    if mode != AutoresetMode.DISABLED:
        raise ValueError(
            f"the environment's autoreset mode is {mode}; make it with AutoresetMode.DISABLED, so "
            "that a slot restarts when its replay has ended and not before"
        )
    for what, space, wanted in (
        ("observations", env.single_observation_space, records.n_sensors),
        ("actions", env.single_action_space, records.n_commands),
    ):
        if not isinstance(space, gymnasium.spaces.Box) or space.shape != (wanted,):
            raise ValueError(
                f"the environment's {what} are {space}; the records have {wanted} numbers a row, "
                f"so a Box of shape ({wanted},) is needed"
            )
