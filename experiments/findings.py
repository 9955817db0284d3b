"""Which of the paper's claims hold? Its numbers beside ours, from studies that were run.

    python experiments/findings.py [--results results] [--large results/large] [--against FOLDER]

Reads the folders that `jaxreplay run experiments/NAME.toml` wrote, and those of
`experiments/large.sh`. Studies that were not run are left out. Rates of one set of demonstrations
come with Wilson's 95 % intervals, all else with Student's over the sets (see `sets.py`).

With `--against`, each large rate of success is compared with that of another run of `large.sh`, at
other seeds or positions, by Welch's t-test over sets.
"""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.stats import ttest_ind
from sets import (
    average,
    by_set,
    gain,
    interval,
    number,
    open_sets,
    percent,
    points,
    success,
    won,
)

import jaxreplay as jr
from jaxreplay.figures.table import short
from jaxreplay.plane.params import SENSOR_NAMES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.study.dataset import cells
from jaxreplay.study.worlds.plane import STALLS

WIDE = (10**-2.05, 10**-0.45)  # the paper's range of good θ_I
JUMPS = ("own_tau", "same_tau")


class Row(NamedTuple):
    """A line of the result: what it is of, its runs, and what they are compared with."""

    name: str
    runs: xr.Dataset
    others: xr.Dataset | None = None  # none: it is what others are compared with


Rows = Callable[[xr.Dataset], Iterator[Row]]
Value = Callable[[Row], str]


def main():
    """Print a block for each claim."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("results"), help="of the paper's size")
    parser.add_argument(
        "--large", type=Path, default=Path("results/large"), help="of the large size"
    )
    parser.add_argument("--against", type=Path, help="another folder of the large size")
    options = parser.parse_args()
    for claim, paper, study, rows, value in CLAIMS:
        print(f"\n{claim}\n  {'the paper':50}{paper}")
        for size, folder in (
            ("its size", options.results / study),
            ("large", options.large / study),
            ("large, same_tau", options.large / f"{study}_same_tau"),
        ):
            try:
                runs = opened(folder)
            except FileNotFoundError:
                if not folder.name.endswith("_same_tau"):
                    print(f"  {size:50}not run: {folder}")
                continue
            again = options.against and options.against / folder.name
            compared = again and size != "its size" and again.is_dir()
            others = {row.name: row for row in rows(opened(again))} if compared else {}
            for row in rows(runs):
                text = value(row)
                if other := others.get(row.name):
                    text += f"; again {percent(success(other.runs))}, p = {p_value(row, other):.2g}"
                print(f"  {f'{size}, {row.name}':50}{text}")


def opened(folder: Path) -> xr.Dataset:
    """Return the study in a folder, or those of several sets in its subfolders, by `seed`."""
    if (folder / "study.json").exists():
        return jr.open_study(folder).expand_dims("seed")
    return open_sets(folder)


def p_value(row: Row, other: Row) -> float:
    """Return how probable so large a difference of two rates is if sets differ by chance alone."""
    return float(ttest_ind(by_set(won(row.runs)), by_set(won(other.runs)), equal_var=False).pvalue)


def by_theta_i(low: float = 0.0, high: float = 1.0) -> Rows:
    """Return a function that yields the runs of each reading with each θ_I in a range."""

    def rows(study: xr.Dataset) -> Iterator[Row]:
        for jump in JUMPS:
            runs = study.sel(jump=jump)
            for k, value in enumerate(runs.theta_i.values):
                if low <= value <= high:
                    first = runs.isel(theta_i=0) if k else None
                    yield Row(f"{jump}, θ_I {value:.2g}", runs.isel(theta_i=k), first)

    return rows


def by_jump(study: xr.Dataset) -> Iterator[Row]:
    """Yield the runs of each reading."""
    for jump in JUMPS:
        yield Row(jump, study.sel(jump=jump))


def by(*factors: str, first: str = "") -> Rows:
    """Return a function that yields each combination of factors' values.

    Each is compared with the one that has the first value of the factor `first`.
    """

    def rows(study: xr.Dataset) -> Iterator[Row]:
        names = [name for name in ("theta_i", *factors) if name in study.dims]
        for values, runs in cells(study, names):
            others = None
            if first and values[first] != study[first].values[0]:
                at = {name: values[name] for name in names if name != first}
                others = study.sel(at).isel({first: 0})
            name = ", ".join(f"{study[n].attrs['symbol']} {short(v)}" for n, v in values.items())
            yield Row(name, runs, others)

    return rows


def around(study: xr.Dataset) -> Iterator[Row]:
    """Yield the runs in the demonstrated area, and outside it, in and out of the camera's sight."""
    x, y = study.cube_x, study.cube_y
    (low_x, low_y), (high_x, high_y) = DEMONSTRATED.min(axis=0), DEMONSTRATED.max(axis=0)
    inside = (x >= low_x) & (x <= high_x) & (y >= low_y) & (y <= high_y)
    seen = np.abs(np.arctan2(y, x)) < PlaneParams().field_of_view / 2
    for jump in JUMPS:
        for name, where in (
            ("demonstrated area", inside),
            ("outside, in sight", ~inside & seen),
            ("outside, out of sight", ~inside & ~seen),
        ):
            runs = study.sel(jump=jump).isel(position=where.values)
            yield Row(f"{jump}, {name}, {where.sum().item()} positions", runs)


def by_ignored(study: xr.Dataset) -> Iterator[Row]:
    """Yield the runs without some sensors: those whose σ is above their range."""
    for k in range(study.sizes["sigma_camera"]):
        runs = study.isel(sigma_camera=k)
        ignored = [name for name in SENSOR_NAMES if runs[f"sigma_{name}"] > 1]
        yield Row(
            f"without {', '.join(ignored) or 'none'}",
            runs,
            study.isel(sigma_camera=0) if k else None,
        )


def plateau(study: xr.Dataset) -> Iterator[Row]:
    """Yield all cells of the map, and its flat part."""
    for name, theta_i, theta_tau, low, high in (
        ("all cells", 1, 1, 0, 1),
        ("θ_I ≤ 10^-1.5, θ_τ ≤ 0.05, σ 0.02–0.22", 10**-1.4, 0.05, 0.02, 0.22),
        ("θ_I ≤ 10^-1.5, θ_τ ≤ 0.05, σ 0.02–0.1", 10**-1.4, 0.05, 0.02, 0.11),
    ):
        flat = study.sel(theta_i=study.theta_i <= theta_i, theta_tau=study.theta_tau <= theta_tau)
        yield Row(name, flat.sel(sigma=(flat.sigma >= low) & (flat.sigma <= high)))


def rates(row: Row) -> str:
    """Return the rate of success, and its difference to that of the others."""
    text = f"S {percent(success(row.runs))} %"
    if len(each := 100 * by_set(won(row.runs))) > 1:
        text += f", by set {each.min():.0f}–{each.max():.0f}"
    if row.others is not None:
        text += f", difference {points(gain(row.runs, row.others))}"
    return text


def how_well(row: Row) -> str:
    """Return success, alignment error and duration."""
    error, duration = average(row.runs, "alignment_error"), average(row.runs, "duration")
    return f"{rates(row)}, {number(error)} mm, {number(duration, 0)} s"


def stalls(row: Row) -> str:
    """Return the share of failures that are stalls, fixed or cyclic, and the kinds of failures."""
    outcome, stall = row.runs.outcome, row.runs.stall
    failed = (outcome != "S") & (outcome != "")
    each = by_set(failed)
    share = interval(by_set(stall.isin(STALLS[:2])) / np.where(each > 0, each, np.nan))
    kinds = [f"{kind} {int((stall == kind).sum())}" for kind in STALLS]
    kinds += [f"{way} {int((outcome == way).sum())}" for way in ("Fb", "Fg")]
    return f"{percent(share)} % of {int(failed.sum())} failures are stalls: {', '.join(kinds)}"


def success_and_stalls(row: Row) -> str:
    """Return the rate of success, and the share of failures that are stalls."""
    return f"{rates(row)}; {stalls(row)}"


CLAIMS: tuple[tuple[str, str, str, Rows, Value], ...] = (
    (
        "S is about 90 % for θ_I in [10^-2, 10^-0.5]",
        "about 90 %",
        "theta_i",
        by_theta_i(*WIDE),
        rates,
    ),
    ("S drops for smaller θ_I", "it drops", "theta_i", by_theta_i(0, WIDE[0]), success_and_stalls),
    (
        "the alignment error is small and flat, the duration relatively constant",
        "about 2 mm, about 100 s",
        "theta_i",
        by_theta_i(),
        how_well,
    ),
    ("most failures are stalls", "60 %", "theta_i", by_jump, stalls),
    (
        "with 6 records it degrades gracefully (θ_I = 10^-0.5)",
        "11 of 15, 2.1 mm, 99.5 s",
        "interpolation",
        by("records"),
        how_well,
    ),
    (
        "dithering alleviates the stalls",
        "a guess",
        "dithering",
        by("motor_unit", "dithering", first="dithering"),
        success_and_stalls,
    ),
    (
        "a full battery is best",
        "observed",
        "battery",
        by("battery", first="battery"),
        how_well,
    ),
    ("one wide range of parameters does", "7 values of θ_I", "grid", plateau, rates),
    ("σ is semantics, not noise", "stated", "noise", by("sensor_noise", "sigma"), rates),
    (
        "a sensor without relevance to the task disturbs",
        "feared",
        "light",
        by("light", first="light"),
        how_well,
    ),
    ("it cannot extrapolate", "stated", "outside", around, rates),
    (
        "jumps help, as demonstrations differ at the beginning",
        "believed",
        "jumps",
        by("records", first="theta_i"),
        how_well,
    ),
    ("which sensors matter", "future work", "sensors", by_ignored, how_well),
    ("other controllers", "–", "rivals", by("track_bias", "controller", first="controller"), rates),
    (
        "other controllers, fewer records",
        "–",
        "rivals_records",
        by("records", "controller", first="controller"),
        rates,
    ),
    (
        "other controllers, a push on the way",
        "–",
        "rivals_push",
        by("push", "controller", first="controller"),
        rates,
    ),
)

if __name__ == "__main__":
    main()
