"""A study as a table: how the runs of each cell ended, how accurate they were and how fast."""

from collections.abc import Iterator
from statistics import NormalDist
from typing import Any

import numpy as np
import xarray as xr

from jaxreplay.study.dataset import along, axes_of, cells, meanings, samples_of, told, words


def table(dataset: xr.Dataset) -> str:
    """Return a table with a row for each cell of the study.

    Args:
        dataset: a study, as :func:`jaxreplay.open_study` returns it.
    """
    dims = axes_of(dataset)
    columns = {}
    heads = {}
    for name in (name for dim in dims for name in along(dataset, dim)):
        values = [short(value) for value in dataset[name].values]
        heads[name] = dataset[name].attrs["symbol"] + units(dataset, name)
        columns[name] = max(11, *(len(text) + 2 for text in (heads[name], *values)))
    ways, stalls, shown = list(meanings(dataset)), words(dataset, "stall"), told(dataset)
    lines = [
        "".join(head.rjust(columns[name]) for name, head in heads.items())
        + "".join(f"{name:>6}" for name in ways)
        + ("  lifted" if "lifted" in dataset else "")
        + f"{'S, %':>15}{'− first, %':>17}"
        + "".join(f"{name:>8}" for name in stalls)
        + "".join(_head(dataset[name]).rjust(_width(dataset[name])) for name in shown)
    ]
    for (values, runs), first in zip(cells(dataset, dims), _firsts(dataset, dims), strict=True):
        outcome = runs.outcome.values
        row = "".join(short(value).rjust(columns[name]) for name, value in values.items())
        row += "".join(f"{np.sum(outcome == o):6d}" for o in ways)
        row += _lifted(runs).rjust(8) if "lifted" in dataset else ""
        row += rate(np.sum(outcome == "S"), np.sum(outcome != "")).rjust(15)
        row += ("–" if first is None else difference(outcome, first.outcome.values)).rjust(17)
        row += "".join(f"{np.sum(runs.stall.values == s):8d}" for s in stalls)
        for name in shown:
            row += mean_and_error(counted(runs, name)).rjust(_width(dataset[name]))
        lines.append(row)
    lines += [
        "",
        "; ".join(f"{code}: {meaning}" for code, meaning in meanings(dataset).items())
        + ("; an Fs is a fixed or cyclic stall, or slow." if stalls else "."),
        ("lifted: the cube was lifted at any time. " if "lifted" in dataset else "")
        + "S, %: with Wilson's 95 % interval. ±: standard error of the mean.",
        "− first: difference of S to the first value of the last axis, with its 95 % interval; "
        f"runs are paired by {' and '.join(samples_of(dataset))}.",
        *_lost(dataset),
        _audited(dataset),
    ]
    return "\n".join(lines)


def counted(runs: xr.Dataset, name: str) -> np.ndarray:
    """Return the values of a variable that tables and figures show: of S alone, or of all runs."""
    values = runs[name].values[runs.outcome.values == "S" if _of_success(runs[name]) else ...]
    return values[np.isfinite(values)]


def _of_success(values: xr.DataArray) -> bool:
    return values.attrs.get("of") == "S"


def _head(values: xr.DataArray) -> str:
    """Return the head of a column, such as "error of S, mm"."""
    unit = values.attrs["units"]
    text = values.attrs["column"] + (" of S" if _of_success(values) else "")
    return text if unit == "1" else f"{text}, {unit}"


def _width(values: xr.DataArray) -> int:
    return max(len(_head(values)) + 4, 18)


def _firsts(dataset: xr.Dataset, dims: list[str]) -> Iterator[xr.Dataset | None]:
    """Yield what each cell is compared to: the first along the last axis that varies.

    That cell itself is compared to none: None.
    """
    varying = [dim for dim in dims if dataset.sizes[dim] > 1]
    for index in np.ndindex(*(dataset.sizes[dim] for dim in dims)):
        at = dict(zip(dims, index, strict=True))
        first = at | dict.fromkeys(varying[-1:], 0)
        yield dataset.isel(first) if first != at else None


def _lifted(runs: xr.Dataset) -> str:
    """Return in how many runs the cube was lifted; – where that is not known."""
    lifted = runs.lifted.values[runs.outcome.values != ""]
    return f"{np.sum(lifted == 1)}" if np.isfinite(lifted).any() else "–"


def _lost(dataset: xr.Dataset) -> list[str]:
    """Return a line on runs that were lost, if there are any and it is known."""
    if "distance" not in dataset:
        return []
    limit, distance = float(dataset.distance.attrs["lost"]), dataset.distance.values
    lost, known = int(np.sum(distance > limit)), int(np.isfinite(distance).sum())
    if lost == 0:
        return []
    return [
        f"Lost: {lost} of {known} runs were more than {limit:g} σ off the sample followed for half "
        "of their steps: check the sensors' units, signs and order, and the rate."
    ]


def _audited(dataset: xr.Dataset) -> str:
    """Return a line on how far windows changed the commands."""
    off = dataset.command_error.values
    off = off[np.isfinite(off)]
    if len(off) == 0:
        return "Audit: no run was filtered again with the complete belief."
    return (
        f"Audit: {len(off)} of the runs filtered again with the complete belief; commands differed "
        f"by more than 1e-3 of their range in {np.sum(off > 1e-3)}, at most by {np.max(off):.1e}."
    )


def short(value: Any) -> str:
    """Return a factor's value in a few characters."""
    if isinstance(value, bool | np.bool_):
        return "on" if value else "off"
    return str(value) if isinstance(value, str) else f"{value:.3g}"


def units(dataset: xr.Dataset, name: str) -> str:
    """Return a space and a factor's unit, to follow its value; empty where it has none."""
    unit = dataset[name].attrs.get("units", "")
    return f" {unit}" if unit not in ("", "1") else ""


def mean_and_error(values: np.ndarray) -> str:
    """Return `mean ± standard error`, as far as there are values."""
    if len(values) == 0:
        return "–"
    if len(values) == 1:
        return f"{values[0]:.2f}"
    return f"{values.mean():.2f} ± {standard_error(values):.2f}"


def standard_error(values: np.ndarray) -> float:
    """Return the standard error of the mean; NaN for fewer than two values."""
    return values.std(ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan


def rate(successes: int, n: int) -> str:
    """Return the rate in percent with its interval; see :func:`wilson`."""
    if n == 0:
        return "–"
    low, high = wilson(successes, n)
    return f"{100 * successes / n:.0f} ({100 * low:.0f}–{100 * high:.0f})"


def difference(outcome: np.ndarray, first: np.ndarray) -> str:
    """Return the difference of two cells' success in percentage points, with its interval.

    Runs at the same place in both arrays are pairs: they have a world and a noise in common.
    """
    both = (outcome != "") & (first != "")
    if not both.any():
        return "–"
    one, other = (outcome[both] == "S"), (first[both] == "S")
    low, middle, high = paired(np.sum(one & ~other), np.sum(other & ~one), np.sum(both))
    return f"{100 * middle:+.0f} ({100 * low:+.0f}, {100 * high:+.0f})"


def paired(only_one: int, only_other: int, n: int) -> tuple[float, float, float]:
    """Return the difference of two paired rates, between the ends of its 95 % interval.

    Agresti and Min (2005), eq. 6: Wald's interval after ½ is added to each of the four counts,

        (b − c) / (n + 2) ± 1.96 √((b + c + 1) − (b − c)² / (n + 2)) / (n + 2)

    Args:
        only_one: b, pairs in which only the first succeeded.
        only_other: c, pairs in which only the second did.
        n: pairs.
    """
    apart, size = int(only_one) - int(only_other), int(n) + 2
    error = 1.96 * (int(only_one) + int(only_other) + 1 - apart**2 / size) ** 0.5 / size
    middle = apart / size
    return max(middle - error, -1.0), apart / int(n), min(middle + error, 1.0)


def wilson(successes: int, n: int) -> tuple[float, float]:
    """Return Wilson's 95 % score interval of the rate p = `successes` / n, within [0, 1].

        (p + z²/2n ± z √(p (1 − p) / n + z²/4n²)) / (1 + z²/n),  z = 1.96

    It contains the rates that a score test at 5 % does not reject, so it has a width even where
    none or all succeeded. Runs are assumed to be independent. After no run at all it is (0, 1).
    """
    if n == 0:
        return 0.0, 1.0
    # Written out: SciPy's statistics take half a second to import.
    p, z = successes / n, NormalDist().inv_cdf(0.975)
    middle, width = p + z**2 / (2 * n), z * (p * (1 - p) / n + (z / (2 * n)) ** 2) ** 0.5
    low, high = (float((middle + side) / (1 + z**2 / n)) for side in (-width, width))
    return low if successes else 0.0, high if successes < n else 1.0
