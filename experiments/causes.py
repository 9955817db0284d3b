"""Why do our results differ from the paper's? One thing is changed at a time, all else being equal.

    python experiments/causes.py [--only WHAT …] [--sets N] [--workers N] [--out DIR]

Each change is a study of three θ_I in both readings of a jump: for each of `--sets` sets of
demonstrations, one run at each of six positions. Demonstrations are made anew by the changed robot.
What is stored in `--out` is not computed again. Intervals are over sets, 95 % (see `sets.py`).
"""

import argparse
from functools import partial
from itertools import product
from pathlib import Path
from textwrap import fill

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from sets import gain, open_sets, percent, points, success

from jaxreplay import run_study
from jaxreplay.figures.outcomes import READINGS, tick_text
from jaxreplay.machine import keep_compiled
from jaxreplay.study.config import load_config
from jaxreplay.study.workers import local_workers

STUDY = Path(__file__).with_name("theta_i.toml")
FIRST = "as it is"
ALIKE = ["track_bias=0", "placing=0", "heading=0", "cube_turn=0"]
# Each with what it changes in the study. A control period is the teacher's, too.
CHANGES: dict[str, list[str]] = {
    FIRST: [],
    "demonstrations in step": ["controller=in_step:InStep"],
    "plain float32 filter": ["controller=plain_filter:Plain"],
    "plain, motor unit 2 cm/s": ["controller=plain_filter:Plain", "motor_unit=0.02"],
    "motor unit 2 cm/s": ["motor_unit=0.02"],
    "motor unit 0.25 cm/s": ["motor_unit=0.0025"],
    "no track bias": ["track_bias=0"],
    "every run alike": ALIKE,
    "taught by a finer motor": [*ALIKE, "motor_unit=0.01", "taught=nominal"],
    "σ 0.03": ["sigma=0.03"],
    "σ 0.3": ["sigma=0.3"],
    "no sensor noise": ["sensor_noise=0"],
    "5 steps a second": ["plane.control_period=0.2", "plane.substeps=10"],
    "20 steps a second": ["plane.control_period=0.05", "plane.substeps=3"],
    "servos restart at once": ["plane.servo_restart=0"],
}
SIZE = [
    "repeats=1",
    "axis.theta_i=[0.316227766017,0.01,1e-25]",
    "positions.x.linspace=[0.26,0.39,2]",
    "positions.y.linspace=[-0.09,0.09,3]",
]
JUMPS = ("same_tau", "own_tau")
MARKERS = "os^"


def main():
    """Run what is missing, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=CHANGES, default=CHANGES, metavar="WHAT")
    parser.add_argument("--sets", type=int, default=5, help="of demonstrations, seeds 1 to N")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, default=Path("results/causes"))
    options = parser.parse_args()
    if options.sets < 1:
        parser.error("--sets must be at least 1")
    keep_compiled()
    workers = partial(local_workers, options.workers) if options.workers else None
    folders = {name: options.out / name.replace("/", " per ") for name in options.only}
    for name, folder in folders.items():
        for seed in range(1, options.sets + 1):
            config = load_config(STUDY, [*SIZE, f"seed={seed}", *CHANGES[name]])
            run_study(config, folder / f"{seed}", workers=workers)
        print(f"{name}: done", flush=True)
    runs = {name: open_sets(folder) for name, folder in folders.items()}
    print(table(runs))
    for suffix in ("png", "pdf"):
        figure(runs, options.out / f"causes.{suffix}")
    print(f"{options.out}: causes.png and causes.pdf")


def table(runs: dict[str, xr.Dataset]) -> str:
    """Return the table: of each reading and θ_I a block, with a row for each change."""
    first, lines = runs.get(FIRST), []
    for jump, v in product(JUMPS, next(iter(runs.values())).theta_i.values):
        cell = {"jump": jump, "theta_i": v}
        head = f"{jump}, θ_I {v:.2g}"
        lines += ["", f"{head:28}{'S, %':>14}{'− as it is':>18}{'Fs':>5}{'Fg':>5}{'Fb':>5}"]
        for name, study in runs.items():
            of, change = study.sel(cell), "–"
            if first is not None and name != FIRST:
                change = points(gain(of, first.sel(cell).sel(seed=of.seed)))
            counts = "".join(f"{int((of.outcome == code).sum()):5}" for code in ("Fs", "Fg", "Fb"))
            lines.append(f"{name:28}{percent(success(of)):>14}{change:>18}{counts}")
    return "\n".join(lines)


def figure(runs: dict[str, xr.Dataset], path: Path):
    """Draw S of each change with its interval; a panel for each reading."""
    rows = np.arange(len(runs))
    theta_i = next(iter(runs.values())).theta_i.values
    aside = np.linspace(-0.5, 0.5, len(theta_i) + 2)[1:-1] * 0.88
    with plt.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        height = 0.45 + 0.35 * max(len(rows), 3)
        drawn, axes = plt.subplots(1, 2, figsize=(8, height), layout="constrained", sharey=True)
        for ax, jump in zip(axes, JUMPS, strict=True):
            for k, (v, marker) in enumerate(zip(theta_i, MARKERS, strict=True)):
                each = [success(study.sel(jump=jump, theta_i=v)) for study in runs.values()]
                s, low, high = 100 * np.clip(each, 0, 1).T
                ax.errorbar(
                    s, rows + aside[k], xerr=[s - low, high - s], fmt=marker, markersize=4,
                    color=str(0.4 * k / max(2, len(theta_i) - 1)),
                    markerfacecolor="white" if k else "black",
                    capsize=2, lw=0.8, label=f"$\\theta_I$ = {tick_text('theta_i', v)}",
                )  # fmt: skip
            ax.set_title(fill(READINGS[jump], 44), loc="left", fontsize=8)
            ax.set_xlabel("S, % (whiskers: 95 % over sets of demonstrations)")
            ax.set_xlim(-3, 103)
            ax.grid(axis="y", lw=0.3)
        axes[0].set_yticks(rows, runs)
        axes[0].set_ylim(len(rows) - 0.5, -0.5)
        drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=6,
                     frameon=False)  # fmt: skip
        drawn.savefig(path, dpi=150)
        plt.close(drawn)


if __name__ == "__main__":
    main()
