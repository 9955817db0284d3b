"""Does a replay count the laps of a loop, and can it drive more than were shown?

    python experiments/loop.py [--repeats 15] [--out results/loop]

§ 4: "our model is not explicitly able to handle loops, although practically it might be (up to a
certain point) due to the non-zero probability of past time steps". Here a point robot is shown
how to drive some laps around a circle and then leave to a goal. What it sees, its position and a
lamp, is the same in each lap: only the filter's memory of τ tells laps apart.

Asked is, first, how often it drives the laps shown: by their number, θ_I, θ_τ and σ, with more
noise, with demonstrations that differ in speed, start or laps, and when it is held or carried
along the circle on the way. Then, where a lamp lit half a lap before tells when to leave,
how often it drives the laps which that takes, though other numbers were shown, and how far it gets
off the circle meanwhile.

Each run of a cell follows 8 demonstrations of its own, so that its runs are independent, as
Wilson's interval assumes; cells that were shown the same share them.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, product
from pathlib import Path
from typing import NamedTuple

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from tqdm import tqdm

from jaxreplay import Params, Records
from jaxreplay.machine import cores, keep_compiled
from jaxreplay.replay import replay
from jaxreplay.table import wilson

N, LONGEST = 8, 400  # records, and samples of each: one shape, one compiled program
PERIOD, RADIUS, LAP = 0.1, 0.5, 30  # s, m, samples a lap at the usual speed
SPEED = 2 * np.pi * RADIUS / (LAP * PERIOD)  # m/s
GOAL, ARRIVED, AREA = 1.5, 0.2, 2.5  # m
SENSOR_NOISE, MOTOR_NOISE = 0.02, 0.1 * SPEED  # standard deviations a step: m, m/s
LAMP = 0.1  # σ of the lamp, which is 0 or 1
STEPS = 420  # in which it must be at the goal
JUMPS = ("same_tau", "own_tau")


class Shown(NamedTuple):
    """What is demonstrated."""

    laps: tuple[int, ...]  # in turn
    speeds: float = 0.1  # speeds are within this share of the usual one
    starts: float = 0.2  # starts are within this angle of where the circle is left, rad
    lamp: bool = False  # whether a lamp is lit half a lap before leaving


class Cell(NamedTuple):
    """What runs have in common."""

    shown: Shown
    jump: str
    theta_i: float
    theta_tau: float = 0.05
    sigma: float = 0.1  # of a coordinate, m
    noise: float = 1.0  # times the demonstrations'
    held: int = 0  # samples, after one and a half laps
    carried: float = 0.0  # laps along the circle, after one and a half
    wanted: int = 0  # laps that the lamp tells, if any

    def laps(self) -> tuple[int, ...]:
        """Those that are right."""
        return (self.wanted,) if self.shown.lamp else self.shown.laps


class Circle(VectorEnv):
    """Point robots on the complex plane, told a velocity; each sees its position and a lamp."""

    metadata = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012 - as in Gymnasium

    def __init__(self, slots: int):
        """So many robots."""
        self.num_envs = slots
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,))
        self.single_action_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,))
        self.position = np.ones(slots, complex)
        self.angle, self.off, self.t, self.held = np.zeros((4, slots))
        self.disturbed, self.resting = np.zeros((2, slots), bool)
        self.noise = np.zeros((slots, STEPS, 4))

    def reset(self, *, seed, options):
        """Place robots near the circle, `start` rad after where it is left."""
        for b in np.flatnonzero(options["reset_mask"]):
            self.resting[b] = seed[b] is None
            if not self.resting[b]:
                rng = np.random.default_rng(seed[b])
                self.noise[b] = options["noise"][b] * rng.normal(size=(STEPS, 4))
                self.angle[b], self.held[b] = options["start"][b], options["held"][b]
                self.position[b] = RADIUS * rng.uniform(0.9, 1.1) * np.exp(1j * self.angle[b])
                self.t[b], self.off[b], self.disturbed[b] = 0, 0, False
        self.options = options
        return np.zeros((self.num_envs, 3)), {}

    def step(self, actions):
        """Drive a step.

        It tells laps around the centre, whether a robot is at the goal, and how far off the
        circle it was, at most, before its last half lap.
        """
        now = np.minimum(self.t, STEPS - 1).astype(int)
        noise = self.noise[np.arange(self.num_envs), now]
        half_way = self.angle >= 3 * np.pi
        held = half_way & (self.held > 0)
        carried = np.where(half_way & ~self.disturbed, 2 * np.pi * self.options["carried"], 0)
        self.held -= held
        self.disturbed |= half_way
        velocity = (actions + MOTOR_NOISE * noise[:, :2]) @ [1, 1j]
        moved = self.position + PERIOD * np.where(held, 0, velocity)
        self.angle += np.angle(moved / self.position) + carried
        self.position = moved * np.exp(1j * carried)
        self.t += 1

        distance = np.abs(self.position)
        last = self.angle >= 2 * np.pi * (self.options["wanted"] - 0.5)
        self.off = np.where(last, self.off, np.maximum(self.off, np.abs(distance - RADIUS)))
        x, y = self.position.real, self.position.imag
        seen = np.stack([x, y, last & self.options["lamp"]], axis=1)
        seen[:, :2] += SENSOR_NOISE * noise[:, 2:]
        arrived = np.abs(self.position - GOAL) < ARRIVED
        over = arrived | (distance > AREA)
        info = {"laps": self.angle / (2 * np.pi), "arrived": arrived, "off": self.off}
        return seen, np.zeros(len(seen)), over, self.t >= STEPS, info


def options(n: int, **told) -> dict[str, np.ndarray]:
    """For n runs, whatever is not told left out."""
    usual = {"start": 0.0, "noise": 1.0, "held": 0, "carried": 0.0}
    return {name: np.broadcast_to(value, n) for name, value in (usual | told).items()}


def demonstrate(shown: Shown, rng: np.random.Generator) -> Records:
    """Laps and the way to the goal, N times; each recorded on until all have one length."""
    laps = np.resize(shown.laps, N)
    speed = SPEED * (1 + shown.speeds * rng.uniform(-1, 1, N))
    start = shown.starts * rng.uniform(-1, 1, N)
    env, left = Circle(N), np.zeros(N, bool)
    told = options(N, start=start, wanted=laps, lamp=shown.lamp)
    seeds = rng.integers(2**32, size=N)
    env.reset(seed=seeds, options=told | {"reset_mask": np.ones(N, bool)})
    sensors, commands = np.zeros((N, LONGEST, 3)), np.zeros((N, LONGEST, 2))
    for t in range(LONGEST):
        distance, way = np.abs(env.position), GOAL - env.position
        around = speed * env.position / distance * (1j + 2 * (1 - distance / RADIUS))
        ahead = way / np.abs(way) * np.minimum(speed, np.abs(way) / PERIOD / 2)
        left |= env.angle >= 2 * np.pi * laps
        command = np.where(left, ahead, around)
        commands[:, t] = np.stack([command.real, command.imag], axis=1)
        sensors[:, t], *_ = env.step(commands[:, t])
    return Records.from_sequences(list(sensors), list(commands), period=PERIOD)


def drive(task: tuple[list[Cell], int]) -> dict[Cell, tuple[float, float]]:
    """Once each of the cells that share what is shown.

    Returns:
        Laps driven, NaN if it never came to the goal, and how far it got off the circle.
    """
    cells, repeat = task
    shown, found = cells[0].shown, {}
    rng = np.random.default_rng([repeat, *repr(shown).encode()])
    records = demonstrate(shown, rng)
    for jump in JUMPS:
        some = [cell for cell in cells if cell.jump == jump]
        n = len(some)
        of = {name: np.array([getattr(c, name) for c in some]) for name in Cell._fields[2:]}
        sigma = np.stack([of["sigma"], of["sigma"], np.full(n, LAMP)], axis=1)
        done = replay(
            records,
            Params(of["theta_i"], of["theta_tau"], sigma),
            Circle(n),
            jump,
            [int(seed) for seed in rng.integers(2**32, size=n)],
            options(
                n, noise=of["noise"], held=of["held"], carried=of["carried"], lamp=shown.lamp,
                wanted=[min(c.laps()) for c in some],
            ),
        )  # fmt: skip
        laps = np.where(done.info["arrived"], np.round(done.info["laps"]), np.nan)
        found |= dict(zip(some, zip(laps, done.info["off"], strict=True), strict=True))
    return found


THETA_I = (10**-0.5, 1e-1, 1e-2, 1e-3, 1e-6, 0.0)
FEW = (10**-0.5, 1e-1, 1e-3)
EIGHT = Shown((8,))
CONDITIONS = {
    "8 laps, θ_τ 0.01": {"theta_tau": 0.01},
    "8 laps, θ_τ 0.2": {"theta_tau": 0.2},
    "8 laps, σ 0.3 m": {"sigma": 0.3},
    "8 laps, σ 0.6 m": {"sigma": 0.6},
    "8 laps, noise × 3": {"noise": 3.0},
    "8 laps, held 3 s": {"held": LAP},
    "8 laps, held 10 s": {"held": 100},
    "8 laps, carried ¼ lap ahead": {"carried": 0.25},
    "8 laps, carried ¼ lap back": {"carried": -0.25},
    "8 laps, carried ½ lap ahead": {"carried": 0.5},
}
SHOWN = {
    "8 laps, shown in step": Shown((8,), 0.0, 0.0),
    "8 laps, shown at speeds ± 30 %": Shown((8,), 0.3),
    "8 laps, shown from starts ± ¼ lap": Shown((8,), starts=np.pi / 2),
    "3, 4 or 5 laps": Shown((3, 4, 5)),
}
LAMPS = {
    "2 laps": Shown((2,), lamp=True),
    "2 laps in step": Shown((2,), 0.0, 0.0, lamp=True),
    "1 and 4 laps": Shown((1, 4), lamp=True),
}
WANTED = range(1, 7)


def questions() -> dict[str, list[Cell]]:
    """The table's rows."""
    laps = {f"{k} lap{'s' * (k > 1)}": (Shown((k,)), {}, THETA_I) for k in (1, 2, 4, 8)}
    conditions = {name: (EIGHT, what, FEW) for name, what in CONDITIONS.items()}
    shown = {name: (what, {}, FEW) for name, what in SHOWN.items()}
    lamps = {
        f"{name} shown, told {m}": (what, {"wanted": m}, FEW)
        for name, what in LAMPS.items()
        for m in WANTED
    }
    return {
        name: [Cell(shown, jump, t, **what) for jump in JUMPS for t in theta_i]
        for name, (shown, what, theta_i) in (laps | conditions | shown | lamps).items()
    }


def run(repeats: int) -> dict[Cell, np.ndarray]:
    """All cells: `[repeats, 2]` laps and distances of each."""
    alike = {}
    for cell in chain(*questions().values()):
        alike.setdefault(cell.shown, []).append(cell)
    tasks = [(cells, k) for cells in alike.values() for k in range(repeats)]
    found = {}
    with ThreadPoolExecutor(cores()) as threads:
        done = tqdm(threads.map(drive, tasks), total=len(tasks), unit="set", disable=None)
        for some in done:
            for cell, driven in some.items():
                found.setdefault(cell, []).append(driven)
    return {cell: np.array(driven) for cell, driven in found.items()}


def print_table(found: dict[Cell, np.ndarray]):
    """For each reading a row for each question, and how many runs were right at each θ_I."""
    n = len(next(iter(found.values())))
    print(f"Of {n} runs each, how many were right: at the goal, after laps that were shown, or as")
    print("many as the lamp told; and Wilson's 95 % interval, %. Of all θ_I together: how many")
    print("drove fewer or more, or were lost, that is, never at the goal; and how far the right")
    print("ones got off the circle before their last half lap, m, the median.")
    for jump in JUMPS:
        print(f"\n{jump:34}" + "".join(f"{f'θ_I {t:.3g}':>14}" for t in THETA_I), end="")
        print(f"{'fewer':>7}{'more':>6}{'lost':>6}{'off':>6}")
        for name, cells in questions().items():
            of = {cell.theta_i: cell for cell in cells if cell.jump == jump}
            rates = [rate(of[t], found) if t in of else (0, 0, 0) for t in THETA_I]
            row = [f"{k} ({100 * low:.0f}–{100 * high:.0f})" * (high > 0) for k, low, high in rates]
            laps, off = np.concatenate([found[cell] for cell in of.values()]).T
            allowed = cells[0].laps()
            right = np.isin(laps, allowed)
            fewer, more, lost = laps < min(allowed), laps > max(allowed), np.isnan(laps)
            print(f"{name:34}" + "".join(f"{text:>14}" for text in row), end="")
            print(f"{fewer.sum():7d}{more.sum():6d}{lost.sum():6d}", end="")
            print(f"{np.median(off[right]):6.2f}" if right.any() else f"{'–':>6}")
    print("\nLaps driven where 3, 4 and 5 were shown: how many runs, at all θ_I together")
    for jump in JUMPS:
        some = [found[c][:, 0] for c in questions()["3, 4 or 5 laps"] if c.jump == jump]
        laps, runs = np.unique(some, return_counts=True)
        told = (f"{k:g}: {m}" for k, m in zip(laps, runs, strict=True) if k == k)
        print(f"{jump:9}" + ", ".join([*told, f"lost: {np.isnan(some).sum()}"]))


def rate(cell: Cell, found: dict[Cell, np.ndarray]) -> tuple[int, float, float]:
    """How many runs drove the right number of laps and came to the goal; the rate's interval."""
    laps = found[cell][:, 0]
    right = int(np.isin(laps, cell.laps()).sum())
    return right, *wilson(right, len(laps))


def draw(found: dict[Cell, np.ndarray], folder: Path):
    """Rates of right runs; saved as PNG and PDF."""
    what = f"right number of laps, % of {len(next(iter(found.values())))} runs"
    asked = {name: cells for name, cells in questions().items() if not cells[0].shown.lamp}
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = plt.figure(figsize=(9.5, 6), layout="constrained")
        axes, *lamps = figure.subplot_mosaic("ab\nac").values()
        for jump in JUMPS:
            cells = [next(c for c in some if c.jump == jump) for some in asked.values()]
            rates(axes, range(len(cells)), cells, found, lying=True)
        axes.set_yticks(range(len(asked)), asked)
        axes.invert_yaxis()
        axes.set(xlim=(-3, 103), xlabel=what)
        axes.set_title("As many laps as shown", loc="left", fontsize=9)
        axes.legend(frameon=False, loc="lower left", bbox_to_anchor=(0, 0.2))
        for axes, name in zip(lamps, ("2 laps", "1 and 4 laps"), strict=True):
            for k in LAMPS[name].laps:
                axes.axvspan(k - 0.3, k + 0.3, color="0.9", zorder=0)
            for jump, theta_i in product(JUMPS, (FEW[0], FEW[2])):
                cells = [Cell(LAMPS[name], jump, theta_i, wanted=m) for m in WANTED]
                rates(axes, WANTED, cells, found)
            axes.set(ylim=(-3, 103), xlabel="laps the lamp tells (grey: shown)", ylabel=what)
            axes.set_title(f"As many laps as a lamp tells, {name} shown", loc="left", fontsize=9)
        lamps[1].legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.2, 0))
        folder.mkdir(parents=True, exist_ok=True)
        for suffix in ("png", "pdf"):
            figure.savefig(folder / f"loop.{suffix}", dpi=150)
        plt.close(figure)


def rates(axes: plt.Axes, at: range, cells: list[Cell], found: dict, lying: bool = False):
    """Points and intervals of cells that differ in one thing; lying, or joined by a line."""
    jump, theta_i = cells[0].jump, cells[0].theta_i
    right, low, high = np.array([rate(cell, found) for cell in cells]).T
    p = right / len(found[cells[0]])
    bars = 100 * np.maximum(0, [p - low, high - p])
    aside = (-0.12 if jump == JUMPS[0] else 0.12) + (0 if theta_i == FEW[0] else 0.06)
    where = np.array(at) + aside
    colour = "#1f4e79" if jump == JUMPS[0] else "#c05a00"
    axes.errorbar(
        *((100 * p, where) if lying else (where, 100 * p)), **{"xerr" if lying else "yerr": bars},
        label=f"{jump}, $\\theta_I$ $10^{{{np.log10(theta_i):.3g}}}$",
        linestyle="none" if lying else "-" if theta_i == FEW[0] else ":", linewidth=1, capsize=2,
        color=colour, markerfacecolor=colour if theta_i == FEW[0] else "white",
        marker="o" if jump == JUMPS[0] else "s", markersize=4.5,
    )  # fmt: skip


def main():
    """Drive, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=15, help="runs a cell")
    parser.add_argument("--out", type=Path, default=Path("results/loop"), metavar="DIR")
    told = parser.parse_args()
    if told.repeats < 1:
        parser.error("--repeats must be at least 1")
    keep_compiled()
    found = run(told.repeats)
    print_table(found)
    draw(found, told.out)


if __name__ == "__main__":
    main()
