"""The closed loop (§ 2.3): the filter, or another controller, drives an environment."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from gymnasium.vector import VectorEnv

from jaxreplay.filter.belief import DEFAULT_JUMP, Jump
from jaxreplay.filter.options import LAST_STEPS, Start, options_of
from jaxreplay.loop.checks import check_batch, check_end, check_environment, check_types
from jaxreplay.loop.controller import Controller, FilterController, MakeController
from jaxreplay.params import Params
from jaxreplay.records import Records

COMPLETED = 0.9  # § 2.2.5
LOST = 3.0  # σ: a replay whose median distance from what it follows is larger was lost


class LostWarning(UserWarning):
    """Replays were far from what they followed for half of their steps."""


class Replays(NamedTuple):
    """Results of n replays.

    Attributes:
        ending: `[n]` how each ended: "terminated" (by the environment), else "completed" (by the
            controller: the belief reached the records' end), else "truncated" (by the
            environment); empty while it runs.
        steps: `[n]` control steps taken.
        reward: `[n]` sum of the environment's rewards.
        log_evidence: `[n]` log p(Z_1:t) of the replay; NaN if the controller has none.
        info: the environment's info of each replay's last step, `[n, …]` by name; where it gave
            none: NaN for floats, else 0, False or an empty string.
        widened: `[n]` times that a step was computed again in a wider window.
        dropped: `[n]` log2 of the probability of the most probable hypothesis that windows
            dropped (see `Belief.dropped`); −∞ for none.
        distance_median: `[n]` in σ, the median over steps of the distance from the observation to
            the state followed (see :mod:`jaxreplay.filter.distance`); NaN if the controller has
            none, and while the replay runs.
        distance_max: `[n]` the largest such distance so far; NaN likewise.
        observations: of each replay asked for, a list of its `[n_s]` Z_t.
    """

    ending: np.ndarray
    steps: np.ndarray
    reward: np.ndarray
    log_evidence: np.ndarray
    info: dict[str, np.ndarray]
    widened: np.ndarray
    dropped: np.ndarray
    distance_median: np.ndarray
    distance_max: np.ndarray
    observations: dict[int, list[np.ndarray]]


def replay(
    records: Records,
    params: Params,
    env: VectorEnv,
    seeds: Sequence[int],
    *,
    jump: Jump = DEFAULT_JUMP,
    start: Start = "first",
    last_steps: int | None = LAST_STEPS,
    period: float | None = None,
    options: Mapping[str, np.ndarray] | None = None,
    keep: Sequence[int] = (),
    progress: Callable[[Replays], None] = lambda so_far: None,
    controller: MakeController | str = FilterController,
) -> Replays:
    """Replay the records n times in the B slots of an environment.

    A slot is a sub-environment of `env`; it has one replay at a time. All slots advance together,
    and a slot whose replay has ended is given the next. A replay is complete when p(τ in the last
    10 samples) exceeds 0.9 (§ 2.2.5). So it may end up to 10 samples before its records do: let
    them go on for 10 samples after the goal is reached, or choose `last_steps`.

    Commands are sent within the range that each has in the records (those of a controller of one's
    own as they are), and rounded where the environment's actions are whole numbers. A replay that
    was lost, more than 3 σ off what it followed for half of its steps, causes a warning.

    Args:
        records: demonstrations of the environment's observations and actions.
        params: `[n]`-batched parameters, or one set for all.
        env: any Gymnasium vector environment with Box observations and actions whose autoreset
            is disabled. If it has an attribute `resting` (`[B]` bool), slots whose replay has ended
            are set True there, and the environment may skip them; its reset sets them False.
        seeds: n seeds, one for each replay.
        jump: `"same_tau"` or `"own_tau"`.
        start: `"first"`, at the records' first samples (equation 5), or `"anywhere"` in them.
        last_steps: samples at a record's end that count as its end; 10 in the paper. None: the
            environment alone ends a replay.
        period: s between the environment's steps, to which records of another period are resampled
            (see :meth:`jaxreplay.Records.resampled`). None: the environment's `control_period`, if
            it has one and the records' is known; else records are taken as they are.
        options: for the environment's reset, `[n, …]` by name; the environment receives those of
            its slots, `[B, …]`, and `reset_mask`, `[B]` bool, the slots to reset. (Gymnasium's own
            SyncVectorEnv passes the whole `[B, …]` arrays to each sub-environment.)
        keep: replays whose observations are returned.
        progress: called with the results so far after every control step.
        controller: what turns observations into commands: the name of one of
            :data:`jaxreplay.loop.rivals.CONTROLLERS`, or a constructor, called as
            `controller(records, params, options)` (see :mod:`jaxreplay.loop.controller`).

    Returns:
        How each replay went: how it ended, its steps, reward, evidence and distance, see
        :class:`Replays`.

    Example:
        ::

            how = {"vector_kwargs": {"autoreset_mode": AutoresetMode.DISABLED}}
            env = gymnasium.make_vec("Pendulum-v1", 8, vectorization_mode="sync", **how)
            done = jr.replay(records, params, env, seeds=range(20), last_steps=None)

    Raises:
        ValueError: environment and records do not fit each other, or its autoreset is enabled;
            there is not one set of parameters and one value of each option for each seed; an option
            has no such value.
    """
    choices = options_of(jump, start, last_steps)
    check_types(records, params)
    if isinstance(seeds, int):
        raise ValueError(f"seeds is {seeds}; give a list with one seed for each replay")
    check_environment(records, env)
    if np.ndim(params.theta_i) == 0 and np.ndim(params.sigma) == 1:
        params = jax.tree.map(lambda x: np.broadcast_to(x, (len(seeds), *x.shape)), params)
    check_batch(records, params, len(seeds), options or {})
    if isinstance(controller, str):
        from jaxreplay.loop.rivals import controller_named  # imports this package's controller

        controller = controller_named(controller)
    if period is None and records.period is not None:
        period = getattr(env.unwrapped, "control_period", None)
    if period is not None:
        records = records.resampled(period)
    check_end(records, last_steps)
    slots = jax.tree.map(lambda x: x[np.zeros(env.num_envs, int)], params)
    made = controller(records, slots, choices)
    loop = _Loop(made, params, env, seeds, options or {}, keep, last_steps)
    loop.start(np.ones(env.num_envs, bool))
    while loop.going.any():
        result = loop.step(loop.controller.command)
        loop.observe(result)
        loop.start(loop.end(result))
        progress(loop.replays)
    _warn_of_lost(loop.replays)
    return loop.replays


class _StepResult(NamedTuple):
    """What `env.step` returns, each `[B, …]`."""

    observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    info: dict[str, Any]


class _Loop:
    """The state of :func:`replay`: which replay each slot has, and the results so far."""

    def __init__(self, controller: Controller, params, env, seeds, options, keep, last_steps):
        n, slots = len(seeds), env.num_envs
        self.controller, self.env, self.params = controller, env, params
        self.seeds, self.options = seeds, options
        self.completed = COMPLETED if last_steps else np.inf
        self.distances: list[list[float]] = [[] for _ in range(env.num_envs)]
        self.replay_in_slot = np.zeros(slots, int)  # indices of replays
        self.going = np.zeros(slots, bool)  # slots whose replay has not ended
        self.started = 0  # replays given to a slot so far
        self.over = np.zeros(slots, bool)  # slots to be reset before they can be stepped again
        self.replays = Replays(
            ending=np.full(n, "", dtype="<U10"),
            steps=np.zeros(n, int),
            reward=np.zeros(n),
            log_evidence=np.zeros(n),
            info={},
            widened=np.zeros(n, int),
            dropped=np.full(n, -np.inf),
            distance_median=np.full(n, np.nan),
            distance_max=np.full(n, np.nan),
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
        params = jax.tree.map(lambda x: x[self.replay_in_slot], self.params)
        self.controller.begin(taken, params)
        for b in take:
            self.distances[b] = []

    def step(self, command: np.ndarray) -> _StepResult:
        """Send commands `[B, n_u]`; return what the environment gives back."""
        dtype = np.dtype(self.env.single_action_space.dtype)
        whole = np.issubdtype(dtype, np.integer)
        return _StepResult(*self.env.step((np.rint(command) if whole else command).astype(dtype)))

    def observe(self, result: _StepResult) -> None:
        """Update beliefs with the observations, and the results with what is known now."""
        going, now, replays = self.going, self.replay_in_slot[self.going], self.replays
        z = np.asarray(result.observation, float)
        observed = self.controller.observe(z, going)
        self.end_probability, log_evidence, widened, dropped, distance = (
            np.broadcast_to(value, going.shape) for value in observed
        )
        replays.distance_max[now] = np.fmax(replays.distance_max[now], distance[going])
        for b in np.flatnonzero(going):
            self.distances[b].append(distance[b])
            if self.replay_in_slot[b] in replays.observations:
                replays.observations[self.replay_in_slot[b]].append(z[b].copy())
        replays.steps[now] += 1
        replays.widened[now], replays.dropped[now] = widened[going], dropped[going]
        replays.reward[now] += result.reward[going]
        replays.log_evidence[now] += log_evidence[going]

    def end(self, result: _StepResult) -> np.ndarray:
        """Note which replays ended, and how; return their slots, `[B]` bool."""
        before = self.going.copy()
        for ending, is_so in (
            ("terminated", result.terminated),
            ("completed", self.end_probability > self.completed),
            ("truncated", result.truncated),
        ):
            ends = is_so & self.going
            self.replays.ending[self.replay_in_slot[ends]] = ending
            self.going[ends] = False
        ended = before & ~self.going
        for b in np.flatnonzero(ended):
            self.replays.distance_median[self.replay_in_slot[b]] = np.median(self.distances[b])
        if ended.any():
            _keep_info(self.replays.info, result.info, self.replay_in_slot, ended, len(self.seeds))
        if hasattr(self.env, "resting"):
            self.env.resting[ended] = True
        else:
            self.over = result.terminated | result.truncated
        return ended


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


def _warn_of_lost(replays: Replays) -> None:
    """Warn of replays that were lost."""
    lost = np.flatnonzero(replays.distance_median > LOST)
    if len(lost):
        which = ", ".join(map(str, lost[:5])) + (", …" if len(lost) > 5 else "")
        warnings.warn(
            f"{len(lost)} of {len(replays.steps)} replays were lost ({which}, counted from 0): "
            f"their observations were more than {LOST:g} σ off the sample "
            "followed in half of the steps; check the sensors' units, signs, order and rate, and "
            "where the replay starts",
            LostWarning,
            stacklevel=3,
        )
