"""A study that was run with several sets of demonstrations, and intervals over these sets.

Runs that replay the same demonstrations resemble each other, so an interval of runs alone is too
narrow for a statement about demonstrations in general. Here the unit is the set.
"""

from pathlib import Path

import numpy as np
import xarray as xr
from scipy.stats import t

import jaxreplay as jr
from jaxreplay.figures.table import paired, wilson


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
