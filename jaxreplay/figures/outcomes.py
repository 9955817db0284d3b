"""The paper's figure 3, and how factors are written in figures."""

from textwrap import fill
from typing import Any

import matplotlib
import matplotlib.patheffects
import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jaxreplay.figures.picture import Picture, literal
from jaxreplay.figures.table import counted, short, standard_error, units, wilson
from jaxreplay.study.dataset import axes_of, cells, is_number, meanings, samples_of, told

# Of the outcomes in their order, from light to dark and hatched, so that they differ in grey.
COLOURS = ("#cfe8cf", "#f2b872", "#c0504d", "#3b3b58")
HATCHES = ("", "//", "..", "xx")
SYMBOLS = {"theta_i": "$\\theta_I$", "theta_tau": "$\\theta_\\tau$"}
# Moments τ are positions on a record.
READINGS = {
    "same_tau": "same_tau: a jump keeps τ (equation 6 as printed)",
    "own_tau": "own_tau: each record has its own p(τ)",
}
STYLES = (  # of two variables: marker, its sign, colour, its face, and how far beside the tick
    ("o", "●", "#1f4e79", "#1f4e79", -0.2),
    ("s", "□", "#b35900", "white", 0.2),
)


def figure_3(dataset: xr.Dataset) -> Picture:
    """Draw figure 3 of the paper: outcomes, alignment error and duration along one axis.

    Of an environment, the second panel has the return instead of the error.

    For the choice of that axis, axes of more than two values come first; among them θ_I, then
    numeric axes, then the longest. There is a row of panels for each combination of the others.

    Args:
        dataset: a study.
    """
    if not axes_of(dataset):
        dataset = dataset.expand_dims("theta_i")
    axes = axes_of(dataset)
    along = max(
        axes,
        key=lambda a: (
            dataset.sizes[a] > 2,
            a == "theta_i",
            is_number(dataset, a),
            dataset.sizes[a],
        ),
    )
    if is_number(dataset, along):
        dataset = dataset.sortby(along)
    others = [a for a in axes if a != along]
    panels = list(cells(dataset, others))
    n = len(panels)
    with matplotlib.rc_context({"font.size": 9, "axes.spines.top": False, "hatch.linewidth": 0.5}):
        figure = Picture(figsize=(8, 2.7 * n + 0.5))
        rows = figure.subplots(n, 2, squeeze=False, sharex=True)
        reach = {name: _reach(dataset, name) for name in told(dataset)[: len(STYLES)]}
        for row, (values, runs) in zip(rows, panels, strict=True):
            _outcomes(row[0], runs, along)
            _means(row[1], runs, along, reach)
            row[0].set_title(fill(title(dataset, values), 66), loc="left", fontsize=9)
        for ax in rows[-1]:
            ax.set_xlabel(label(dataset, along))
        handles, labels = rows[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _reach(dataset: xr.Dataset, name: str) -> tuple[float, float]:
    """Return the limits of an axis that has 0 and all bars of standard errors on it."""
    each = (counted(runs, name) for _, runs in cells(dataset, axes_of(dataset)))
    bars = [v.mean() + np.nan_to_num(standard_error(v)) * np.array([-1, 1]) for v in each if len(v)]
    low, high = min([0, *(b[0] for b in bars)]), max([0, *(b[1] for b in bars)])
    return (1.05 * low, 1.05 * high) if high > low else (0, 1)


def title(dataset: xr.Dataset, values: dict[str, Any]) -> str:
    """Return the title of a panel: the factors' values."""
    return ", ".join(
        READINGS[value]
        if name == "jump"
        else f"{SYMBOLS.get(name, literal(dataset[name].attrs['symbol']))} "
        f"{tick_text(name, value)}{units(dataset, name)}"
        for name, value in values.items()
    )


def label(dataset: xr.Dataset, axis: str) -> str:
    """Return the label of an axis: the factor along it, and its unit."""
    symbol = f"{SYMBOLS[axis]}, " if axis in SYMBOLS else ""
    unit = units(dataset, axis) and f",{units(dataset, axis)}"
    return f"{symbol}{literal(dataset[axis].attrs['long_name'])}{unit}"


def tick_text(axis: str, value: Any) -> str:
    """Return a factor's value as it is written at a tick."""
    if axis == "theta_i":
        return "0" if value == 0 else f"$10^{{{np.log10(value):.3g}}}$"
    return literal(short(value))


def places(runs: xr.Dataset, along: str) -> np.ndarray:
    """Return where the values of an axis stand: one apart, and 1.6 where their spacing jumps.

    It jumps where it is more than 2.5 times the median spacing, both of the numbers and of their
    logarithms; of θ_I, of the logarithms alone.
    """
    n = runs.sizes[along]
    if n < 3 or not is_number(runs, along):
        return np.arange(n, dtype=float)
    values = runs[along].values.astype(float)
    spacings = [] if along == "theta_i" else [np.diff(values)]
    if along == "theta_i" or values.min() > 0:
        spacings.append(np.diff(np.log10(np.maximum(values, 1e-30))))
    jumps = [np.abs(d) > 2.5 * np.median(np.abs(d)) for d in spacings]
    return np.concatenate([[0], np.cumsum(1 + 0.6 * np.all(jumps, axis=0))])


def _axis(axes: Axes, runs: xr.Dataset, along: str):
    at = places(runs, along)
    texts = [tick_text(along, value) for value in runs[along].values]
    steep = len(texts) > 8 or (max(map(len, texts)) > 8 and along != "theta_i")
    axes.set_xticks(at, texts, rotation=90 if steep else 0)
    axes.set_xlim(-0.6, at[-1] + 0.6)
    for k in np.flatnonzero(np.diff(at) > 1):  # two strokes across the axis
        axes.text(
            (at[k] + at[k + 1]) / 2, 0, "//", transform=axes.get_xaxis_transform(), ha="center",
            va="center", fontsize=9, zorder=5,
        )  # fmt: skip


def _outcomes(axes: Axes, runs: xr.Dataset, along: str):
    about = meanings(runs)
    counts = {o: (runs.outcome == o).sum(samples_of(runs)).values for o in about}
    total = np.sum(list(counts.values()), axis=0)
    bottom, at = np.zeros(len(total)), places(runs, along)
    for (outcome, count), colour, hatch in zip(counts.items(), COLOURS, HATCHES, strict=True):
        share = 100 * count / np.maximum(total, 1)  # a cell may have no run yet
        axes.bar(
            at, share, 0.75, bottom,
            label=f"{outcome}: {about[outcome]}",
            color=colour, hatch=hatch, edgecolor="black", linewidth=0.5,
        )  # fmt: skip
        bottom += share
    rates = 100 * counts["S"] / np.maximum(total, 1)
    interval = 100 * np.transpose([wilson(*pair) for pair in zip(counts["S"], total, strict=True)])
    bars = axes.errorbar(
        at, rates, np.abs(interval - rates), fmt="none", color="black", capsize=3, lw=1.2, zorder=4
    )
    outline = matplotlib.patheffects.withStroke(linewidth=3.5, foreground="white")
    for part in (*bars.lines[1], *bars.lines[2]):  # seen on hatching by their white outline
        part.set_path_effects([outline])
    axes.set_ylabel(f"runs, % (of {max(total)} each)\nwhiskers: 95 % interval of S", fontsize=8)
    axes.set_ylim(0, 100)
    axes.spines["right"].set_visible(False)
    _axis(axes, runs, along)


def _means(axes: Axes, runs: xr.Dataset, along: str, reach: dict[str, tuple[float, float]]):
    """Draw the means of two variables in each cell, within the limits of their axes."""
    sides, at = (axes, axes.twinx()), places(runs, along)
    of = ["successful runs" if runs[n].attrs.get("of") == "S" else "all runs" for n in reach]
    for ax, style, (name, limits), whose in zip(sides, STYLES, reach.items(), of, strict=True):
        marker, sign, colour, face, shift = style
        for k, (_, cell) in enumerate(cells(runs, [along])):
            values = counted(cell, name)
            if len(values):
                error = standard_error(values) if len(values) > 1 else None
                ax.errorbar(
                    at[k] + shift, values.mean(), error, fmt=marker, color=colour,
                    markersize=5, capsize=3, markerfacecolor=face,
                )  # fmt: skip
            elif ax is axes:
                ax.text(
                    at[k], 0.02, "none", ha="center", fontsize=7, color="grey", rotation=90,
                    transform=ax.get_xaxis_transform(),
                )  # fmt: skip
        about, unit = runs[name].attrs, units(runs, name)
        text = about["long_name"] + (f",{unit}" if unit else "") + f" ({sign})"
        ax.set_ylabel(text if len(set(of)) == 1 else f"{text}\n{whose}", color=colour)
        ax.set_ylim(*limits)
    whose = f"{of[0]}: " if len(set(of)) == 1 else ""
    axes.set_title(f"{whose}mean ± standard error", loc="right", fontsize=8)
    _axis(axes, runs, along)
