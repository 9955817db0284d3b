"""Which of the paper's claims hold? Its numbers beside ours, from studies that were run.

    python experiments/findings.py [--results results] [--large results/large]

Reads the folders that `jaxreplay run experiments/NAME.toml --out FOLDER/NAME` leaves in both; the
large ones are those of `experiments/large.sh`. What was not run is left out. Rates come with
Wilson's 95 % intervals; means with 95 % intervals by bootstrap over positions, at which runs are
alike.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

import jaxreplay as jr
from jaxreplay.plane.demonstrator import DEMONSTRATED
from jaxreplay.plane.params import PlaneParams
from jaxreplay.study import STALLS
from jaxreplay.table import cells, rate, short

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
    """Both readings of a jump."""
    return lambda study: [(jump, value(study.sel(jump=jump))) for jump in JUMPS]


def successes(runs: xr.Dataset) -> str:
    """In percent, with interval."""
    outcome = runs.outcome.values
    return f"S {rate(np.sum(outcome == 'S'), np.sum(outcome != ''))} %"


def within(low: float, high: float) -> Callable[[xr.Dataset], str]:
    """Successes for θ_I in a range, each and together."""

    def value(runs: xr.Dataset) -> str:
        some = runs.sel(theta_i=[v for v in runs.theta_i.values if low <= v <= high])
        each = [(some.sel(theta_i=v).outcome == "S").mean().item() for v in some.theta_i.values]
        return f"{successes(some)}; by θ_I " + ", ".join(f"{100 * s:.0f}" for s in each)

    return value


def mean_by_theta_i(variable: str, unit: str) -> Callable[[xr.Dataset], str]:
    """The mean of successful runs, over all θ_I, and how far its values by θ_I are apart."""

    def value(runs: xr.Dataset) -> str:
        won = runs[variable].where(runs.outcome == "S")
        each = won.mean([d for d in won.dims if d != "theta_i"])
        if not np.isfinite(each).any():
            return "no success"
        low, high = float(each.min()), float(each.max())
        return f"{mean(runs, variable)} {unit}; by θ_I from {low:.1f} to {high:.1f}"

    return value


def mean(runs: xr.Dataset, variable: str) -> str:
    """Of successful runs, with its interval by bootstrap over positions."""
    won = runs[variable].where(runs.outcome == "S").transpose("position", ...)
    rows = won.values.reshape(won.sizes["position"], -1)
    rows = rows[np.isfinite(rows).any(axis=1)]
    if len(rows) == 0:
        return "–"
    rng = np.random.default_rng(0)
    again = [np.nanmean(rows[rng.integers(len(rows), size=len(rows))]) for _ in range(1000)]
    low, high = np.quantile(again, [0.025, 0.975])
    return f"{np.nanmean(rows):.1f} ({low:.1f}–{high:.1f})"


def stalls(runs: xr.Dataset) -> str:
    """The share of failures that are stalls, the robot fixed or in a cycle; and what kind."""
    outcome, stall = runs.outcome.values, runs.stall.values
    failed = np.sum((outcome != "S") & (outcome != ""))
    fixed, cyclic, slow = (np.sum(stall == kind) for kind in STALLS)
    told = f"{rate(fixed + cyclic, failed)} % of {failed} failures: fixed {fixed}, cyclic {cyclic}"
    return f"{told}; slow {slow}" if failed else "no failure"


def how_well(runs: xr.Dataset) -> str:
    """Success, error and duration."""
    return f"{successes(runs)}, {mean(runs, 'alignment_error')} mm, {mean(runs, 'duration')} s"


def by_theta_i(study: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """A study's runs by their θ_I, if it has more than one."""
    if "theta_i" not in study.dims:
        return [("", study)]
    return [(f"θ_I {of['theta_i']:.2g}, ", runs) for of, runs in cells(study, ["theta_i"])]


def with_records(study: xr.Dataset) -> list[tuple[str, str]]:
    """By how many records, or which, are replayed."""
    return [
        (f"{at}{of['records']}", how_well(runs))
        for at, some in by_theta_i(study)
        for of, runs in cells(some, ["records"])
    ]


def dithered(study: xr.Dataset) -> list[tuple[str, str]]:
    """Success and stalls without and with dithering, by motor unit."""
    return [
        (
            f"{100 * of['motor_unit']:g} cm/s, {short(of['dithering'])}",
            f"{successes(runs)}; {stalls(runs)}",
        )
        for of, runs in cells(study, ["motor_unit", "dithering"])
    ]


def charged(study: xr.Dataset) -> list[tuple[str, str]]:
    """Success and duration by the battery's voltage."""
    return [
        (f"{100 * of['battery']:.0f} %", f"{successes(runs)}, {mean(runs, 'duration')} s")
        for of, runs in cells(study, ["battery"])
    ]


def plateau(study: xr.Dataset) -> list[tuple[str, str]]:
    """Success on the whole map, where it is flat, and by the worst of its cells there."""
    told = []
    for name, theta_i, theta_tau, low, high in (
        ("all cells", 1, 1, 0, 1),
        ("θ_I ≤ 10^-1.5, θ_τ ≤ 0.05, σ 0.02–0.22", 10**-1.4, 0.05, 0.02, 0.22),
        ("θ_I ≤ 10^-1.5, θ_τ ≤ 0.05, σ 0.02–0.1", 10**-1.4, 0.05, 0.02, 0.11),
    ):
        flat = study.sel(theta_i=study.theta_i <= theta_i, theta_tau=study.theta_tau <= theta_tau)
        flat = flat.sel(sigma=(flat.sigma >= low) & (flat.sigma <= high))
        worst = (flat.outcome == "S").mean(["position", "repeat"]).min().item()
        told.append((name, f"{successes(flat)}, no cell below {100 * worst:.0f} %"))
    return told


def noisy(study: xr.Dataset) -> list[tuple[str, str]]:
    """Success by σ, for each noise of the sensors."""
    return [
        (
            f"{of['sensor_noise']:g} × the noise",
            ", ".join(f"σ {at['sigma']:.2g}: {successes(c)}" for at, c in cells(runs, ["sigma"])),
        )
        for of, runs in cells(study, ["sensor_noise"])
    ]


def lit(study: xr.Dataset) -> list[tuple[str, str]]:
    """Without and with a sensor of the light in the room."""
    return [
        (f"{at}light {short(of['light'])}", how_well(runs))
        for at, some in by_theta_i(study)
        for of, runs in cells(some, ["light"])
    ]


def around(study: xr.Dataset) -> list[tuple[str, str]]:
    """Success where cubes were demonstrated, and elsewhere, in and out of the camera's sight."""
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
    ("σ is semantics, not noise", "said", "noise", noisy),
    ("a sensor without a part in it disturbs", "feared", "light", lit),
    ("it cannot extrapolate", "said", "outside", around),
)

if __name__ == "__main__":
    main()
