"""A study in words: how the runs of each cell ended, and how well and how fast."""

from collections.abc import Iterator

import numpy as np
import xarray as xr

from jaxreplay.factors import FACTORS
from jaxreplay.study import OUTCOMES, STALLS


def cells(dataset: xr.Dataset, dims: list[str]) -> Iterator[tuple[dict, xr.Dataset]]:
    """Each combination of places along some dimensions: its factors' values, and its runs."""
    sizes = [dataset.sizes[dim] for dim in dims]
    for index in np.ndindex(*sizes):
        at = dict(zip(dims, index, strict=True))
        values = {
            name: dataset[name].values[k] for dim, k in at.items() for name in along(dataset, dim)
        }
        yield values, dataset.isel(at)


def along(dataset: xr.Dataset, dim: str) -> list[str]:
    """The factors that vary along a dimension, its own first."""
    names = [name for name in FACTORS if name in dataset.coords]
    return sorted((n for n in names if dataset[n].dims == (dim,)), key=lambda n: n != dim)


def axes_of(dataset: xr.Dataset) -> list[str]:
    """The dimensions along which factors vary."""
    return [name for name in dataset.outcome.dims if name in FACTORS]


def table(dataset: xr.Dataset) -> str:
    """A row for each cell of the study."""
    dims = axes_of(dataset)
    columns = {}
    for name in (name for dim in dims for name in along(dataset, dim)):
        values = [short(value) for value in dataset[name].values]
        columns[name] = max(
            11, *(len(text) + 2 for text in (FACTORS[name].symbol + units(name), *values))
        )
    lines = [
        "".join((FACTORS[name].symbol + units(name)).rjust(w) for name, w in columns.items())
        + "".join(f"{name:>6}" for name in OUTCOMES)
        + f"{'S, %':>15}"
        + "".join(f"{name:>8}" for name in STALLS)
        + f"{'error of S, mm':>18}{'duration of S, s':>20}"
    ]
    for values, runs in cells(dataset, dims):
        outcome, stall = runs.outcome.values, runs.stall.values
        row = "".join(short(value).rjust(columns[name]) for name, value in values.items())
        row += "".join(f"{np.sum(outcome == o):6d}" for o in OUTCOMES)
        row += rate(np.sum(outcome == "S"), np.sum(outcome != "")).rjust(15)
        row += "".join(f"{np.sum(stall == s):8d}" for s in STALLS)
        for name, width in (("alignment_error", 18), ("duration", 20)):
            row += mean_and_error(runs[name].values[outcome == "S"]).rjust(width)
        lines.append(row)
    lines += [
        "",
        "S, %: with Wilson's 95 % interval. fixed, cyclic, slow: the Fs. "
        "±: standard error of the mean.",
        _audited(dataset),
    ]
    return "\n".join(lines)


def _audited(dataset: xr.Dataset) -> str:
    """What windows cost in accuracy, in a line."""
    off = dataset.command_error.values
    off = off[np.isfinite(off)]
    return (
        f"Audit: of {len(off)} filtered again without windows, commands were off by more than "
        f"1e-3 of their range in {np.sum(off > 1e-3)}; at most by {np.max(off, initial=0):.1e}."
    )


def short(value) -> str:
    """A factor's value in a few characters."""
    if isinstance(value, bool | np.bool_):
        return "on" if value else "off"
    return str(value) if isinstance(value, str) else f"{value:.3g}"


def units(axis: str) -> str:
    """What follows a factor's value, or nothing."""
    unit = FACTORS[axis].units
    return f" {unit}" if unit not in ("", "1") else ""


def mean_and_error(values: np.ndarray) -> str:
    """`mean ± standard error`, as far as there are values."""
    if len(values) == 0:
        return "–"
    if len(values) == 1:
        return f"{values[0]:.2f}"
    return f"{values.mean():.2f} ± {standard_error(values):.2f}"


def standard_error(values: np.ndarray) -> float:
    """Of the mean; NaN for fewer than two values."""
    return values.std(ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan


def rate(successes: int, n: int) -> str:
    """In percent, with its interval; see :func:`wilson`."""
    if n == 0:
        return "–"
    low, high = wilson(successes, n)
    return f"{100 * successes / n:.0f} ({100 * low:.0f}–{100 * high:.0f})"


def wilson(successes: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % score interval of a rate: (p + z²/2n ± z √(p(1 − p)/n + z²/4n²)) / (1 + z²/n).

    p = successes / n, z = 1.96. It holds the rates that a score test at 5 % does not reject, so
    that it has a width where none or all succeeded, and stays within [0, 1]. Runs are taken to be
    independent. E. B. Wilson, Probable inference, the law of succession, and statistical inference,
    J. Am. Stat. Assoc. 22 (1927), 209–212.

    Args:
        successes: 0 … n.
        n: trials; after none, the rate may be anything in [0, 1].
    """
    if n == 0:
        return 0.0, 1.0
    z, p = 1.959964, successes / n
    middle, half = p + z**2 / (2 * n), z * np.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2)
    scale = 1 + z**2 / n
    return float(max(0, middle - half) / scale), float(min(scale, middle + half) / scale)
