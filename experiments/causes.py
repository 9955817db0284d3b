"""Why do we differ from the paper? One thing is changed at a time, all else being equal.

    python experiments/causes.py [--theta-i V …] [--only WHAT …] [--ahead N] [--aside N] [--out DIR]

Two of the paper's claims are not reproduced here: that S is about 90 % up to θ_I = 10^-0.5 when
equation 6 is read as printed, and that S drops for small θ_I. So each of three θ_I, or those
specified, is replayed in both readings of a jump, one run at each of `--ahead` × `--aside`
positions, unchanged ("as it is") and with

- demonstrations in step: warped in time so that all are in the same situation at the same moment;
- a plain filter (`plain_filter.py`): float32 probabilities as one would write them at first, which
  underflow;
- other sensor noise, motor units or control periods. A control period is the teacher's, too.

`--only` names the changes to run. Results are stored in the folder `--out`, and are not computed
again. Intervals are Wilson's, 95 %.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from plain_filter import PlainTracker

from jaxreplay import Params, Records
from jaxreplay.figures.outcomes import READINGS, tick_text
from jaxreplay.figures.table import rate, wilson
from jaxreplay.loop.controller import FilterController
from jaxreplay.loop.replay import replay
from jaxreplay.loop.tracker import Tracker
from jaxreplay.machine import keep_compiled, write_whole
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import seed_of
from jaxreplay.plane.params import NOMINAL, SENSOR_RANGES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED, facing
from jaxreplay.study.demonstrations import record
from jaxreplay.study.worlds.plane import Plane

SEED = 2012
SLOTS = 56
THETA_I = (10**-0.5, 10**-2, 1e-25)
OLD = PlaneParams(**NOMINAL)  # the world in which every run is alike
MARKERS = "os^vD*"
JUMPS = ("same_tau", "own_tau")


class Variant(NamedTuple):
    """A change: of the replay's plane, of the demonstrations', of the records, or of the filter."""

    plane: PlaneParams = OLD
    demonstrated: PlaneParams = OLD
    warp: Callable[[Records], Records] = lambda records: records
    tracker: Callable[[Records, Params, str], Any] = Tracker


def main():
    """Run what is missing, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--theta-i", type=float, nargs="+", default=THETA_I, metavar="V")
    parser.add_argument("--only", nargs="+", choices=VARIANTS, default=VARIANTS, metavar="WHAT")
    parser.add_argument("--ahead", type=int, default=6, help="positions, 26 to 39 cm ahead")
    parser.add_argument("--aside", type=int, default=10, help="… and up to 9 cm aside")
    parser.add_argument("--out", type=Path, default=Path("results/causes"))
    options = parser.parse_args()
    theta_i = tuple(options.theta_i)
    if min(options.ahead, options.aside) < 1:
        parser.error("--ahead and --aside must be at least 1")
    if len(theta_i) > len(MARKERS) or not all(0 <= v <= 1 for v in theta_i):
        parser.error(f"--theta-i must be at most {len(MARKERS)} values within 0 and 1")
    keep_compiled()
    options.out.mkdir(parents=True, exist_ok=True)
    places = np.linspace(0.26, 0.39, options.ahead), np.linspace(-0.09, 0.09, options.aside)
    positions = np.array(list(product(*places)))
    kept = options.out / f"{options.ahead}x{options.aside}.json"
    found = json.loads(kept.read_text()) if kept.exists() else {}
    for name in options.only:
        missing = {
            key(name, jump, v): (jump, v) for jump, v in product(JUMPS, theta_i)
            if key(name, jump, v) not in found
        }  # fmt: skip
        if missing:
            variant = VARIANTS[name]
            records = variant.warp(record(variant.demonstrated, DEMONSTRATED, SEED))
            for cell, (jump, v) in missing.items():
                found[cell] = run(variant, records, jump, v, positions)
                write_whole(kept, json.dumps(found, indent=1).encode())
                print(f"{cell}: {' '.join(found[cell])}", flush=True)
    asked = {
        name: {jump: [found[key(name, jump, v)] for v in theta_i] for jump in JUMPS}
        for name in options.only
    }
    print(table(asked, theta_i))
    for suffix in ("png", "pdf"):
        figure(asked, theta_i, options.out / f"causes.{suffix}")
    print(f"{options.out}: causes.png and causes.pdf")


def key(name: str, jump: str, theta_i: float) -> str:
    """Return the name under which the outcomes of a cell's runs are stored."""
    return f"{name}, {jump}, {theta_i:g}"


def run(
    variant: Variant, records: Records, jump: str, theta_i: float, positions: np.ndarray
) -> list[str]:
    """Return the outcome of a replay at each position."""
    n = len(positions)
    params = Params(
        np.full(n, theta_i), np.full(n, 0.05), np.tile(0.1 * np.array(SENSOR_RANGES), (n, 1))
    )
    env = PlaneVectorEnv(min(SLOTS, n), variant.plane)
    seeds = [seed_of(SEED, k) for k in range(n)]
    options = {"cube": facing(positions)}
    replays = replay(
        records,
        params,
        env,
        seeds,
        jump=jump,
        options=options,
        controller=partial(FilterController, tracker=variant.tracker),
    )
    return Plane.outcome(replays).tolist()


def in_step(records: Records) -> Records:
    """Warp demonstrations in time, so that all are in the same situation at the same moment.

    Each is aligned with the one of median length: at each moment of that one it advances by 0 to 3
    samples, such that the sum of squared differences between sensors and commands, as shares of
    their ranges, is least. Tracks then run faster or slower, and drive as far as before.
    """
    sensors, commands = records.sequences()
    ranges = [np.ptp(np.concatenate(rows), axis=0) for rows in (sensors, commands)]
    both = [
        np.hstack([s / ranges[0], c / ranges[1]]) for s, c in zip(sensors, commands, strict=True)
    ]
    model = both[np.argsort([len(rows) for rows in both])[len(both) // 2]]
    warped = [
        _warped(_fitted(rows, model), s, c)
        for rows, s, c in zip(both, sensors, commands, strict=True)
    ]
    names = records.sensor_names, records.command_names
    return Records.from_sequences(*zip(*warped, strict=True), *names, records.period)


def _fitted(rows: np.ndarray, model: np.ndarray) -> np.ndarray:
    """Return the index of the row aligned with each of the model's, by dynamic programming."""
    apart = ((model[:, None] - rows) ** 2).sum(axis=2)
    usual = len(rows) / len(model)
    best, came = np.full(len(rows), np.inf), np.zeros(apart.shape, int)
    best[0] = apart[0, 0]
    for i in range(1, len(model)):
        ways = np.full((4, len(rows)), np.inf)
        for step in range(4):
            ways[step, step:] = best[: len(rows) - step] + 1e-3 * (step - usual) ** 2
        came[i] = ways.argmin(axis=0)
        best = ways.min(axis=0) + apart[i]
    path = [len(rows) - 1]
    for i in range(len(model) - 1, 0, -1):
        path.append(path[-1] - came[i, path[-1]])
    return np.array(path[::-1])


def _warped(path: np.ndarray, sensors: np.ndarray, commands: np.ndarray):
    """Return sensors and commands along a path through their rows, smoothed over a second."""
    rows = np.arange(len(sensors))
    padded = np.pad(path, 5, mode="edge")
    even = np.convolve(padded, np.full(11, 1 / 11), mode="valid")
    driven = np.vstack([[0, 0], np.cumsum(commands[:, :2], axis=0)])
    at = np.append(even, len(rows))
    at[0] = 0
    tracks = np.column_stack(
        [np.diff(np.interp(at, np.append(rows, len(rows)), d)) for d in driven.T]
    )
    seen = np.column_stack([np.interp(even, rows, s) for s in sensors.T])
    return seen, np.hstack([tracks, commands[even.round().astype(int), 2:]])


def _at(period: float, substeps: int) -> Variant:
    plane = replace(OLD, control_period=period, substeps=substeps)
    return Variant(plane, plane)


VARIANTS = {
    "as it is": Variant(),
    "demonstrations in step": Variant(warp=in_step),
    "plain float32 filter": Variant(tracker=PlainTracker),
    "no sensor noise": Variant(replace(OLD, sensor_noise=0.0)),
    "4 times the sensor noise": Variant(replace(OLD, sensor_noise=4.0)),
    "motor unit 0.25 cm/s": Variant(replace(OLD, motor_unit=0.0025)),
    "motor unit 1 cm/s": Variant(replace(OLD, motor_unit=0.01)),
    "5 steps a second": _at(0.2, 10),
    "20 steps a second": _at(0.05, 3),
}


Asked = dict[str, dict[str, list[list[str]]]]  # outcomes by change, reading and θ_I


def table(asked: Asked, theta_i: tuple[float, ...]) -> str:
    """Return the table: a row for each variant, with S and the number of stalls."""
    heads = [f"{jump} {v:.3g}" for jump in JUMPS for v in theta_i]
    lines = [f"{'S, %, by reading and θ_I':26}" + "".join(f"{head:>18}" for head in heads)]
    for name, by_jump in asked.items():
        cells = [cell for jump in JUMPS for cell in by_jump[jump]]
        lines.append(f"{name:26}" + "".join(f"{rate(c.count('S'), len(c)):>18}" for c in cells))
        stalls = [f"Fs {c.count('Fs')}" for c in cells]
        lines.append(" " * 26 + "".join(f"{text:>18}" for text in stalls))
    return "\n".join(lines)


def figure(asked: Asked, theta_i: tuple[float, ...], path: Path):
    """Draw S of each variant with its interval; a panel for each reading."""
    rows = np.arange(len(asked))
    aside = np.linspace(-0.5, 0.5, len(theta_i) + 2)[1:-1] * 0.88
    with plt.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        height = 0.45 + 0.35 * max(len(rows), 3)
        drawn, axes = plt.subplots(1, 2, figsize=(8, height), layout="constrained", sharey=True)
        for ax, jump in zip(axes, JUMPS, strict=True):
            for k, (v, marker) in enumerate(zip(theta_i, MARKERS, strict=False)):
                cells = [by_jump[jump][k] for by_jump in asked.values()]
                s = np.array([100 * c.count("S") / len(c) for c in cells])
                reach = 100 * np.array([wilson(c.count("S"), len(c)) for c in cells]).T
                ax.errorbar(
                    s, rows + aside[k], xerr=np.abs(reach - s), fmt=marker, markersize=4,
                    color=str(0.4 * k / max(2, len(theta_i) - 1)),
                    markerfacecolor="white" if k else "black",
                    capsize=2, lw=0.8, label=f"$\\theta_I$ = {tick_text('theta_i', v)}",
                )  # fmt: skip
            ax.set_title(fill(READINGS[jump], 44), loc="left", fontsize=8)
            ax.set_xlabel("S, % (whiskers: 95 %)")
            ax.set_xlim(-3, 103)
            ax.grid(axis="y", lw=0.3)
        axes[0].set_yticks(rows, asked)
        axes[0].set_ylim(len(rows) - 0.5, -0.5)
        drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=6,
                     frameon=False)  # fmt: skip
        drawn.savefig(path, dpi=150)
        plt.close(drawn)


if __name__ == "__main__":
    main()
