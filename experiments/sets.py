"""A study that was run with several sets of demonstrations, and intervals over these sets.

    python experiments/sets.py results/large/theta_i --out theta_i_sets.png

draws success against θ_I, for each set and the mean over sets; or against another axis, a line for
each controller. The functions serve other scripts.

Runs that replay the same demonstrations resemble each other, so an interval of runs alone is too
narrow for a statement about demonstrations in general. Here the unit is the set.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from scipy.stats import t

import jaxreplay as jr
from jaxreplay.figures.outcomes import tick_text
from jaxreplay.figures.table import paired, wilson

ACROSS = {  # axes that are drawn from left to right
    "theta_i": "θ_I",
    "records": "demonstrations, drawn from 20",
    "push": "push on the way",
    "track_bias": "track bias",
}


def main():
    """Draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of large.sh, with a study for each seed")
    parser.add_argument("--out", type=Path, default=Path("results/sets.png"))
    parser.add_argument(
        "--pooled", action="store_true", help="draw a map as `jaxreplay plot` does, of all sets"
    )
    options = parser.parse_args()
    study = open_sets(options.folder)
    if options.pooled:
        draw = jr.plot_map if study.sizes["position"] > 50 else jr.plot
        draw(pooled(study)).savefig(options.out, dpi=150)
    else:
        figure(study, options.out)
    print(options.out)


def open_sets(folder: Path) -> xr.Dataset:
    """Return the studies in a folder's subfolders, one for each seed, along the dimension `seed`.

    Raises:
        FileNotFoundError: there is none.
    """
    seeds = sorted(int(path.parent.name) for path in folder.glob("*/study.json"))
    if not seeds:
        raise FileNotFoundError(f"no study in the folders of {folder}: run experiments/large.sh")
    studies = [jr.open_study(folder / str(seed)) for seed in seeds]
    return xr.concat(studies, xr.Variable("seed", seeds), combine_attrs="override", join="exact")


def pooled(study: xr.Dataset) -> xr.Dataset:
    """Return a study with the runs of all sets as repeats."""
    return study.squeeze("repeat", drop=True).rename(seed="repeat")


def by_set(values: xr.DataArray) -> np.ndarray:
    """Return the mean over all dimensions but `seed`; NaN values are left out."""
    return values.mean([dim for dim in values.dims if dim != "seed"]).values


def interval(each: np.ndarray) -> tuple[float, float, float]:
    """Return the mean of the sets' values `[n]`, and the ends of its 95 % interval.

    It is Student's; NaN for a single set.
    """
    each = each[np.isfinite(each)]
    mean = float(each.mean()) if len(each) else np.nan
    if len(each) < 2:
        return mean, np.nan, np.nan
    half = float(t.ppf(0.975, len(each) - 1) * each.std(ddof=1) / np.sqrt(len(each)))
    return mean, mean - half, mean + half


def won(runs: xr.Dataset) -> xr.DataArray:
    """Return 1 for each success, 0 for each failure, NaN where a run is missing."""
    return xr.where(runs.outcome == "", np.nan, runs.outcome == "S")


def success(runs: xr.Dataset) -> tuple[float, float, float]:
    """Return the rate of success, and its 95 % interval over sets.

    It is at least as wide as Wilson's of all runs, which sets that agree by chance do not narrow.
    """
    each = won(runs)
    mean, low, high = interval(by_set(each))
    least, most = wilson(int(each.sum()), int(each.count()))
    return mean, float(np.fmin(low, least)), float(np.fmax(high, most))


def gain(runs: xr.Dataset, others: xr.Dataset) -> tuple[float, float, float]:
    """Return how much more often `runs` succeed than `others`, and its 95 % interval.

    Differences are those within each set; with a single one, those of pairs of runs.
    """
    one, other = won(runs), won(others)
    if one.sizes["seed"] > 1:
        return interval(by_set(one) - by_set(other))
    only_one, only_other = int((one > other).sum()), int((one < other).sum())
    low, middle, high = paired(only_one, only_other, int((one - other).count()))
    return middle, low, high


def average(runs: xr.Dataset, variable: str) -> tuple[float, float, float]:
    """Return a variable's mean over successful runs, by set, and its 95 % interval."""
    return interval(by_set(runs[variable].where(runs.outcome == "S")))


def percent(rate: tuple[float, float, float]) -> str:
    """Return a rate and its interval, if it has one, in percent, such as "87 (80–93)"."""
    return number(tuple(100 * np.clip(rate, 0, 1)), 0)


def points(difference: tuple[float, float, float]) -> str:
    """Return a difference of rates in percentage points, such as "+9 (+4, +14)"."""
    middle, low, high = (f"{100 * x:+.0f}" for x in difference)
    return f"{middle} ({low}, {high})"


def number(value: tuple[float, float, float], digits: int = 1) -> str:
    """Return a number and its interval if it has one, such as "3.1 (2.8–3.4)"; "–" for NaN."""
    middle, low, high = (f"{x:.{digits}f}" for x in value)
    if np.isnan(value).all():
        return "–"
    return middle if np.isnan(value[1]) else f"{middle} ({low}–{high})"


def figure(study: xr.Dataset, path: Path) -> None:
    """Draw success against the study's first axis of numbers.

    Each reading of a jump has a panel, with the sets of demonstrations; or each controller a line.
    """
    axis = next(str(dim) for dim in study.outcome.dims if dim in ACROSS)
    jumps = np.atleast_1d(study.jump.values)
    with plt.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        drawn, panels = plt.subplots(
            1, len(jumps), figsize=(4 * len(jumps), 2.6), sharey=True, layout="constrained",
            squeeze=False,
        )  # fmt: skip
        for axes, jump in zip(panels[0], jumps, strict=True):
            runs = study.sel(jump=jump) if "jump" in study.dims else study
            if "controller" in study.dims:
                names = study.controller.values
                for k, name in enumerate(names):
                    style = {
                        "color": f"C{k}",
                        "fmt": "os^vDPX"[k],
                        "ls": ("-", "--", ":", "-.")[k % 4],
                    }
                    line(axes, runs.sel(controller=name), axis, name, (k - 1.5) / 15, **style)
                continue
            each = [by_set(won(runs.isel({axis: k}))) for k in range(runs.sizes[axis])]
            axes.plot(100 * np.array(each), color="0.75", lw=0.7)
            axes.plot([], [], color="0.75", lw=0.7, label="each set of demonstrations")
            line(axes, runs, axis, "mean, 95 % over sets", color="black", fmt="o-")
            axes.set_title(jump)
        for axes in panels[0]:
            values = study[axis].values
            ticks = [tick_text(axis, v).removesuffix(" drawn") for v in values]
            axes.set_xticks(range(len(ticks)), ticks, fontsize=7)
            unit = study[axis].attrs.get("units", "1")
            axes.set(xlabel=ACROSS[axis] + (f", {unit}" if unit != "1" else ""), ylim=(-3, 103))
        panels[0, 0].set_ylabel("success, %")
        beside = {"loc": "upper left", "bbox_to_anchor": (1, 1)}
        place = beside if "controller" in study.dims else {"loc": "lower right"}
        panels[0, -1].legend(frameon=False, **place)
        drawn.savefig(path, dpi=150)
        plt.close(drawn)


def line(axes: Axes, runs: xr.Dataset, axis: str, label: str, aside: float = 0.0, **style) -> None:
    """Draw success along an axis, with intervals over sets."""
    each = [success(runs.isel({axis: k})) for k in range(runs.sizes[axis])]
    mean, low, high = 100 * np.clip(each, 0, 1).T
    axes.errorbar(
        np.arange(len(mean)) + aside, mean, [mean - low, high - mean], capsize=2, markersize=3,
        label=label, **style,
    )  # fmt: skip


if __name__ == "__main__":
    main()
