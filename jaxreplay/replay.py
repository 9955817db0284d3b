"""The closed loop: the filter drives an environment. The only room where both meet."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import gymnasium
import jax
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from jaxreplay.machine import cores
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.tracker import LANES, Tracker

COMPLETED = 0.9  # § 2.2.5


class Replays(NamedTuple):
    """What n replays came to.

    Attributes:
        ending: `[n]` how each ended: "completed" (the belief reached the records' end),
            "terminated" or "truncated" (by the environment); empty while it goes on.
        steps: `[n]` control steps taken.
        reward: `[n]` sum of the environment's rewards.
        log_evidence: `[n]` log p(Z_1:t) of the whole replay.
        info: what the environment told at each replay's last step, `[n]` for each name; NaN or
            empty where it told nothing.
        widened: `[n]` how often a step was done again in a wider window.
        dropped: `[n]` log2 of the likeliest hypothesis that windows dropped; −inf for none.
        observations: of each replay that was asked for, a list of its `[n_s]` Z_t.
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
    jump: str,
    seeds: Sequence[int],
    options: Mapping[str, np.ndarray] | None = None,
    keep: Sequence[int] = (),
    progress: Callable[[Replays], None] = lambda so_far: None,
    tracker: Callable[[Records, Params, str], Tracker] = Tracker,
) -> Replays:
    """Replay the records n times in the B slots of an environment.

    All slots advance together; one whose replay has ended is given the next. A replay is
    complete once the belief is within the last 10 samples of the records (§ 2.2.5): record on
    for as long after a goal that is to be reached.

    Args:
        records: demonstrations of the environment's observations and actions.
        params: `[n]`-batched parameters.
        env: any Gymnasium vector environment with Box observations and actions whose autoreset
            is disabled. Slots listed in its attribute `resting`, if it has one, cost nothing.
        jump: `"same_tau"` or `"own_tau"`.
        seeds: n seeds, one a replay.
        options: for the environment's reset, `[n, …]` for each name; it is given those of its
            slots, `[B, …]`. (Gymnasium's own SyncVectorEnv hands all of it to each world.)
        keep: replays whose observations are wanted.
        progress: called after every control step.
        tracker: what filters the replays of a chunk; another one serves to compare.

    Raises:
        ValueError: environment and records do not fit each other, or its autoreset is on.
    """
    _check(records, env)
    n, slots = len(seeds), env.num_envs
    options = options or {}
    done = Replays(
        ending=np.full(n, "", dtype="<U10"),
        steps=np.zeros(n, int),
        reward=np.zeros(n),
        log_evidence=np.zeros(n),
        info={},
        widened=np.zeros(n, int),
        dropped=np.full(n, -np.inf),
        observations={k: [] for k in keep},
    )
    # Chunks of one size, so that one program serves all; the last is filled up with lanes that
    # never go on.
    parts = [slice(i, i + LANES) for i in range(0, slots, LANES)]
    lanes = parts[-1].stop
    run, going = np.zeros(lanes, int), np.zeros(lanes, bool)
    z = np.zeros((lanes, records.n_sensors))
    gained, at_end = np.zeros(lanes), np.zeros(lanes)
    chunks = [tracker(records, _of(params, run[part]), jump) for part in parts]
    waiting = 0

    def start(free: np.ndarray):
        """Give waiting runs to free slots; env and chunks begin anew there."""
        nonlocal waiting
        take = np.flatnonzero(free)[: n - waiting]
        run[take] = np.arange(waiting, waiting + len(take))
        going[take] = True
        fresh = free.copy() if waiting == 0 else np.isin(np.arange(slots), take)
        waiting += len(take)
        if not fresh.any():
            return
        told = {name: np.asarray(value)[run[:slots]] for name, value in options.items()}
        each = [seeds[run[b]] if going[b] else None for b in range(slots)]
        env.reset(seed=each, options=told | {"reset_mask": fresh})
        started = np.isin(np.arange(lanes), take)
        for chunk, part in zip(chunks, parts, strict=True):
            if started[part].any():
                chunk.restart(started[part], _of(params, run[part]))

    def advance(chunk: Tracker, part: slice):
        if going[part].any():
            gained[part], at_end[part] = chunk.advance(z[part], going[part])

    start(np.ones(slots, bool))
    with ThreadPoolExecutor(cores()) as threads:
        while going.any():
            command = np.concatenate([chunk.command for chunk in chunks])[:slots]
            z[:slots], reward, terminated, truncated, info = env.step(
                command.astype(env.single_action_space.dtype)
            )
            list(threads.map(advance, chunks, parts))

            for b in np.flatnonzero(going[:slots]):
                if run[b] in done.observations:
                    done.observations[run[b]].append(z[b].copy())
            widened, dropped = (
                np.concatenate([getattr(chunk, name) for chunk in chunks])[:slots]
                for name in ("widened", "dropped")
            )
            now, busy = run[:slots][going[:slots]], going[:slots].copy()
            done.steps[now] += 1
            done.widened[now], done.dropped[now] = widened[busy], dropped[busy]
            done.reward[now] += reward[busy]
            done.log_evidence[now] += gained[:slots][busy]
            completed = at_end[:slots] > COMPLETED
            for name, is_so in (
                ("terminated", terminated),
                ("completed", completed),
                ("truncated", truncated),
            ):
                ends = is_so & going[:slots]
                done.ending[run[:slots][ends]] = name
                going[:slots][ends] = False
            ended = busy & ~going[:slots]
            if ended.any():
                _keep(done.info, info, run[:slots], ended, n)
                if hasattr(env, "resting"):
                    env.resting[ended] = True
                start(ended)
            over = (terminated | truncated) & ~going[:slots]
            if over.any() and not hasattr(env, "resting"):
                env.reset(options={"reset_mask": over})  # it cannot be stepped otherwise
            progress(done)
    return done


def _of(params: Params, runs: np.ndarray) -> Params:
    return jax.tree.map(lambda x: x[runs], params)


def _keep(
    kept: dict[str, np.ndarray], info: dict[str, Any], run: np.ndarray, ended: np.ndarray, n: int
):
    """Take over what the environment tells of the slots that ended, where it tells an array."""
    for name, value in info.items():
        if name.startswith("_") or not isinstance(value, np.ndarray):
            continue
        if name not in kept:
            nothing = np.nan if value.dtype.kind == "f" else value.dtype.type()
            kept[name] = np.full((n, *value.shape[1:]), nothing, value.dtype)
        told = ended & info.get(f"_{name}", True)
        kept[name][run[told]] = value[told]


def _check(records: Records, env: VectorEnv):
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
                f"the environment's {what} are {space}; the records have {wanted} numbers a row"
            )
