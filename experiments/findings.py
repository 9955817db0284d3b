"""Which of the paper's claims hold? Its numbers beside ours, from studies that were run.

    python experiments/findings.py [--results results] [--large results/large]

Reads the folders that `jaxreplay run experiments/NAME.toml --out FOLDER/NAME` wrote in both; the
large ones are those of `experiments/large.sh`. Studies that were not run are left out. Rates come
with Wilson's 95 % intervals; means with 95 % intervals by bootstrap over positions, since runs at
one position resemble each other.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.stats import bootstrap

import jaxreplay as jr
from jaxreplay.figures.table import rate, short
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.study.dataset import cells
from jaxreplay.study.worlds.plane import STALLS

WIDE = (10**-2.05, 10**-0.45)  # the paper's range of good θ_I
JUMPS = ("same_tau", "own_tau")


def main():
    """Print a block for each claim."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("results"), help="of the paper's size")
    parser.add_argument(
        "--large", type=Path, default=Path("results/large"), help="of the large size"
    )
    options = parser.parse_args()
    for claim, paper, study, values in CLAIMS:
        print(f"\n{claim}\n  {'the paper':58}{paper}")
        for size, folder in (
            ("its size", options.results / study),
            ("large", options.large / study),
            ("large, same_tau", options.large / f"{study}_same_tau"),
        ):
            if not (folder / "study.json").exists():
                if not folder.name.endswith("_same_tau"):
                    print(f"  {size:58}not run: {folder}")
                continue
            for name, value in values(jr.open_study(folder)):
                print(f"  {f'{size}, {name}':58}{value}")


Values = Callable[[xr.Dataset], list[tuple[str, str]]]


def by_jump(value: Callable[[xr.Dataset], str]) -> Values:
    """Return a function that evaluates `value` for both readings of a jump."""
    return lambda study: [(jump, value(study.sel(jump=jump))) for jump in JUMPS]


def successes(runs: xr.Dataset) -> str:
    """Return the rate of success in percent, with its interval."""
    outcome = runs.outcome.values
    return f"S {rate(np.sum(outcome == 'S'), np.sum(outcome != ''))} %"


def within(low: float, high: float) -> Callable[[xr.Dataset], str]:
    """Return a function that gives S for θ_I in a range, for all together and for each."""

    def value(runs: xr.Dataset) -> str:
        some = runs.sel(theta_i=[v for v in runs.theta_i.values if low <= v <= high])
        each = [(some.sel(theta_i=v).outcome == "S").mean().item() for v in some.theta_i.values]
        return f"{successes(some)}; by θ_I " + ", ".join(f"{100 * s:.0f}" for s in each)

    return value


def mean_by_theta_i(variable: str, unit: str) -> Callable[[xr.Dataset], str]:
    """Return a function that gives a variable's mean over successes, and its range over θ_I."""

    def value(runs: xr.Dataset) -> str:
        won = runs[variable].where(runs.outcome == "S")
        each = won.mean([d for d in won.dims if d != "theta_i"])
        if not np.isfinite(each).any():
            return "no success"
        low, high = float(each.min()), float(each.max())
        return f"{mean(runs, variable)} {unit}; by θ_I from {low:.1f} to {high:.1f}"

    return value


def mean(runs: xr.Dataset, variable: str) -> str:
    """Return a variable's mean over successful runs, with its interval; "–" without a success.

    Positions are resampled, each with all its runs. A single position gives no interval.
    """
    won = runs[variable].where(runs.outcome == "S")
    others = [dim for dim in won.dims if dim != "position"]
    total, count = won.sum(others).values, won.count(others).values
    total, count = total[count > 0], count[count > 0]
    if len(total) == 0:
        return "–"

    def over_all(total: np.ndarray, count: np.ndarray, axis: int) -> np.ndarray:
        return total.sum(axis=axis) / count.sum(axis=axis)

    average = f"{over_all(total, count, axis=0):.1f}"
    if len(total) == 1:
        return average
    low, high = bootstrap(
        (total, count), over_all, paired=True, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return f"{average} ({low:.1f}–{high:.1f})"


def stalls(runs: xr.Dataset) -> str:
    """Return the share of failures that are stalls, fixed or cyclic, and their kinds."""
    outcome, stall = runs.outcome.values, runs.stall.values
    failed = np.sum((outcome != "S") & (outcome != ""))
    fixed, cyclic, slow = (np.sum(stall == kind) for kind in STALLS)
    if not failed:
        return "no failure"
    share = f"{rate(fixed + cyclic, failed)} % of {failed} failures"
    return f"{share}: fixed {fixed}, cyclic {cyclic}; slow {slow}"


def how_well(runs: xr.Dataset) -> str:
    """Return success, alignment error and duration."""
    return f"{successes(runs)}, {mean(runs, 'alignment_error')} mm, {mean(runs, 'duration')} s"


def by_theta_i(study: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Return a study's runs by their θ_I, with a label if there is more than one."""
    if "theta_i" not in study.dims:
        return [("", study)]
    return [(f"θ_I {of['theta_i']:.2g}, ", runs) for of, runs in cells(study, ["theta_i"])]


def with_records(study: xr.Dataset) -> list[tuple[str, str]]:
    """Return success, error and duration by the records that are replayed."""
    return [
        (f"{at}{of['records']}", how_well(runs))
        for at, some in by_theta_i(study)
        for of, runs in cells(some, ["records"])
    ]


def dithered(study: xr.Dataset) -> list[tuple[str, str]]:
    """Return success and stalls without and with dithering, by motor unit."""
    return [
        (
            f"{100 * of['motor_unit']:g} cm/s, {short(of['dithering'])}",
            f"{successes(runs)}; {stalls(runs)}",
        )
        for of, runs in cells(study, ["motor_unit", "dithering"])
    ]


def charged(study: xr.Dataset) -> list[tuple[str, str]]:
    """Return success and duration by the battery's charge."""
    return [
        (f"{100 * of['battery']:.0f} %", f"{successes(runs)}, {mean(runs, 'duration')} s")
        for of, runs in cells(study, ["battery"])
    ]


def plateau(study: xr.Dataset) -> list[tuple[str, str]]:
    """Return success over the whole map and over its flat part, and of the worst cell in each."""
    found = []
    for name, theta_i, theta_tau, low, high in (
        ("all cells", 1, 1, 0, 1),
        ("θ_I ≤ 10^-1.5, θ_τ ≤ 0.05, σ 0.02–0.22", 10**-1.4, 0.05, 0.02, 0.22),
        ("θ_I ≤ 10^-1.5, θ_τ ≤ 0.05, σ 0.02–0.1", 10**-1.4, 0.05, 0.02, 0.11),
    ):
        flat = study.sel(theta_i=study.theta_i <= theta_i, theta_tau=study.theta_tau <= theta_tau)
        flat = flat.sel(sigma=(flat.sigma >= low) & (flat.sigma <= high))
        worst = (flat.outcome == "S").mean(["position", "repeat"]).min().item()
        found.append((name, f"{successes(flat)}, no cell below {100 * worst:.0f} %"))
    return found


def noisy(study: xr.Dataset) -> list[tuple[str, str]]:
    """Return success by σ, for each noise of the sensors."""
    return [
        (
            f"{of['sensor_noise']:g} × the noise",
            ", ".join(f"σ {at['sigma']:.2g}: {successes(c)}" for at, c in cells(runs, ["sigma"])),
        )
        for of, runs in cells(study, ["sensor_noise"])
    ]


def lit(study: xr.Dataset) -> list[tuple[str, str]]:
    """Return success, error and duration without and with a sensor of the room's light."""
    return [
        (f"{at}light {short(of['light'])}", how_well(runs))
        for at, some in by_theta_i(study)
        for of, runs in cells(some, ["light"])
    ]


def around(study: xr.Dataset) -> list[tuple[str, str]]:
    """Return success in the demonstrated area, and outside it, in and out of the camera's sight."""
    x, y = study.cube_x, study.cube_y
    (low_x, low_y), (high_x, high_y) = DEMONSTRATED.min(axis=0), DEMONSTRATED.max(axis=0)
    inside = (x >= low_x) & (x <= high_x) & (y >= low_y) & (y <= high_y)
    seen = np.abs(np.arctan2(y, x)) < PlaneParams().field_of_view / 2
    return [
        (
            f"{jump}, {name}, {where.sum().item()} positions",
            successes(study.sel(jump=jump).isel(position=where.values)),
        )
        for jump in JUMPS
        for name, where in (
            ("demonstrated area", inside),
            ("outside, in sight", ~inside & seen),
            ("outside, out of sight", ~inside & ~seen),
        )
    ]


CLAIMS: tuple[tuple[str, str, str, Values], ...] = (
    (
        "S is about 90 % for θ_I in [10^-2, 10^-0.5]",
        "about 90 %",
        "theta_i",
        by_jump(within(*WIDE)),
    ),
    ("S drops for smaller θ_I", "it drops", "theta_i", by_jump(within(0, WIDE[0]))),
    (
        "the alignment error is small and flat",
        "about 2 mm",
        "theta_i",
        by_jump(mean_by_theta_i("alignment_error", "mm")),
    ),
    (
        "the duration is relatively constant",
        "about 100 s",
        "theta_i",
        by_jump(mean_by_theta_i("duration", "s")),
    ),
    ("most failures are stalls", "60 %", "theta_i", by_jump(stalls)),
    (
        "with 6 records it degrades gracefully (θ_I = 10^-0.5)",
        "11 of 15, 2.1 mm, 99.5 s",
        "interpolation",
        with_records,
    ),
    ("dithering alleviates the stalls", "a guess", "dithering", dithered),
    ("a full battery is best", "observed", "battery", charged),
    ("one wide range of parameters does", "7 values of θ_I", "grid", plateau),
    ("σ is semantics, not noise", "stated", "noise", noisy),
    ("a sensor without relevance to the task disturbs", "feared", "light", lit),
    ("it cannot extrapolate", "stated", "outside", around),
)

if __name__ == "__main__":
    main()
