"""Does a replay count the laps of a loop, and can it drive more laps than were demonstrated?

    python experiments/loop.py [--repeats 15] [--out results/loop]

§ 4: "our model is not explicitly able to handle loops, although practically it might be (up to a
certain point) due to the non-zero probability of past time steps". Here demonstrations show a point
robot how to drive some laps around a circle and then leave to a goal (`circle.py`). Its sensors are
the same in each lap: only the filter's memory of τ distinguishes laps.

The first question is how often the robot drives as many laps as were shown: by their number, θ_I,
θ_τ and σ, with more noise, with demonstrations that differ in speed, start or laps, and when it is
held or carried along the circle on the way. The second: where a lamp lit half a lap before signals
when to leave, how often does it drive the laps which that requires, though other numbers were
shown, and how far does it get off the circle meanwhile?

Each run of a cell replays 8 demonstrations of its own, so that its runs are independent, as
Wilson's interval assumes; cells with the same demonstrations share them.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, product
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from circle import LAP, Circle, Shown, demonstrate, options
from tqdm import tqdm

from jaxreplay import Params
from jaxreplay.figures.table import wilson
from jaxreplay.loop.replay import replay
from jaxreplay.machine import cores, keep_compiled

LAMP = 0.1  # σ of the lamp, which is 0 or 1
JUMPS = ("same_tau", "own_tau")


class Cell(NamedTuple):
    """What the runs of a cell have in common."""

    shown: Shown
    jump: str
    theta_i: float
    theta_tau: float = 0.05
    sigma: float = 0.1  # of a coordinate, m
    noise: float = 1.0  # times the demonstrations'
    held: int = 0  # samples, after one and a half laps
    carried: float = 0.0  # laps along the circle, after one and a half
    wanted: int = 0  # laps that the lamp asks for, if any

    def laps(self) -> tuple[int, ...]:
        """Return the numbers of laps that are right."""
        return (self.wanted,) if self.shown.lamp else self.shown.laps


def drive(task: tuple[list[Cell], int]) -> dict[Cell, tuple[float, float]]:
    """Do one run of each of the cells that share demonstrations.

    Returns:
        For each cell laps driven, NaN if the robot never reached the goal, and the largest
        distance from the circle before the last half lap, in m.
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
            [int(seed) for seed in rng.integers(2**32, size=n)],
            jump=jump,
            options=options(
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
    """Return the cells of each row of the table."""
    laps = {f"{k} lap{'s' * (k > 1)}": (Shown((k,)), {}, THETA_I) for k in (1, 2, 4, 8)}
    conditions = {name: (EIGHT, what, FEW) for name, what in CONDITIONS.items()}
    shown = {name: (what, {}, FEW) for name, what in SHOWN.items()}
    lamps = {
        f"{name} shown, lamp: {m}": (what, {"wanted": m}, FEW)
        for name, what in LAMPS.items()
        for m in WANTED
    }
    return {
        name: [Cell(shown, jump, t, **what) for jump in JUMPS for t in theta_i]
        for name, (shown, what, theta_i) in (laps | conditions | shown | lamps).items()
    }


def run(repeats: int) -> dict[Cell, np.ndarray]:
    """Run all cells; return laps and distances of each, `[repeats, 2]`."""
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


LEGEND = """\
Of {} runs each, how many were right: at the goal, after as many laps as were shown, or as the lamp
asked for; and Wilson's 95 % interval, %. Of all θ_I together: how many drove fewer or more, or were
lost (never reached the goal); and off: the largest distance of a right run from the circle before
its last half lap, m, the median."""


def print_table(found: dict[Cell, np.ndarray]):
    """Print, for each reading, a row for each question: how many runs were right at each θ_I."""
    print(LEGEND.format(len(next(iter(found.values())))))
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
        counts = (f"{k:g}: {m}" for k, m in zip(laps, runs, strict=True) if k == k)
        print(f"{jump:9}" + ", ".join([*counts, f"lost: {np.isnan(some).sum()}"]))


def rate(cell: Cell, found: dict[Cell, np.ndarray]) -> tuple[int, float, float]:
    """Return how many runs drove the right laps to the goal, and the rate's interval."""
    laps = found[cell][:, 0]
    right = int(np.isin(laps, cell.laps()).sum())
    return right, *wilson(right, len(laps))


def draw(found: dict[Cell, np.ndarray], folder: Path):
    """Draw rates of right runs, and save them as PNG and PDF."""
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
            axes.set(ylim=(-3, 103), xlabel="laps the lamp asks for (grey: shown)", ylabel=what)
            axes.set_title(f"As many laps as a lamp asks for, {name} shown", loc="left", fontsize=9)
        lamps[1].legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.2, 0))
        folder.mkdir(parents=True, exist_ok=True)
        for suffix in ("png", "pdf"):
            figure.savefig(folder / f"loop.{suffix}", dpi=150)
        plt.close(figure)


def rates(axes: plt.Axes, at: range, cells: list[Cell], found: dict, lying: bool = False):
    """Draw points and intervals of cells that differ in one thing; lying, or joined by a line."""
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
    """Run all cells, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=15, help="runs a cell")
    parser.add_argument("--out", type=Path, default=Path("results/loop"), metavar="DIR")
    given = parser.parse_args()
    if given.repeats < 1:
        parser.error("--repeats must be at least 1")
    keep_compiled()
    found = run(given.repeats)
    print_table(found)
    draw(found, given.out)


if __name__ == "__main__":
    main()
