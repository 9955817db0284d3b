"""Success against a numeric factor, with a line for each value of another: a controller, a word."""

import matplotlib
import numpy as np
import xarray as xr

from jaxreplay.figures.outcomes import label, places, tick_text
from jaxreplay.figures.picture import Picture
from jaxreplay.figures.table import wilson
from jaxreplay.study.dataset import axes_of, is_number

# From dark to light, each with a marker and dashes of its own, so that they differ in grey too.
STYLES = (
    ("#1f4e79", "o", "-"),
    ("#b35900", "s", "--"),
    ("#2e6b2e", "^", "-."),
    ("#c0504d", "v", ":"),
    ("#7a5195", "D", (0, (5, 1, 1, 1, 1, 1))),
    ("0.45", "x", (0, (1, 1))),
    ("black", "*", (0, (3, 1))),
)


def compares(dataset: xr.Dataset) -> bool:
    """Return whether a study has just a numeric axis and one of words or switches, 3 or more."""
    axes = axes_of(dataset)
    words = [axis for axis in axes if not is_number(dataset, axis)]
    return len(axes) == 2 and len(words) == 1 and 3 <= dataset.sizes[words[0]] <= len(STYLES)


@matplotlib.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
def comparison(dataset: xr.Dataset) -> Picture:
    """Draw success along the numeric axis, a line for each value of the other.

    Whiskers are Wilson's 95 % intervals; lines stand a little apart, so that none covers another.

    Args:
        dataset: a study that :func:`compares`.
    """
    x, lines = sorted(axes_of(dataset), key=lambda axis: not is_number(dataset, axis))
    dataset = dataset.sortby(x)
    values = dataset[x].values.astype(float)
    spacing = np.diff(values)
    even = len(values) < 3 or spacing.max() < 3 * spacing.min()
    at = values if even else places(dataset, x)
    step = np.diff(at).min() if len(at) > 1 else 1.0
    figure = Picture(figsize=(6, 3.6))
    axes = figure.subplots()
    for k, value in enumerate(dataset[lines].values):
        outcome = dataset.isel({lines: k}).transpose(x, ...).outcome.values.reshape(len(at), -1)
        won, n = (outcome == "S").sum(axis=1), (outcome != "").sum(axis=1)
        low, high = np.array([wilson(*counts) for counts in zip(won, n, strict=True)]).T
        share = np.where(n > 0, won / np.maximum(n, 1), np.nan)
        colour, marker, dashes = STYLES[k]
        axes.errorbar(
            at + step * 0.05 * (k - (dataset.sizes[lines] - 1) / 2),
            100 * share, 100 * np.abs([share - low, high - share]),
            color=colour, marker=marker, linestyle=dashes, markersize=5, capsize=2,
            label=tick_text(lines, value),
        )  # fmt: skip
    axes.set_xticks(at, [tick_text(x, value) for value in values])
    axes.set_xlabel(label(dataset, x))
    axes.set_ylabel(f"S, % of {dataset.outcome[0, 0].size} runs\nwhiskers: 95 % interval")
    axes.set_ylim(-3, 103)
    axes.legend(
        title=dataset[lines].attrs["symbol"], loc="center left", bbox_to_anchor=(1, 0.5),
        frameon=False,
    )  # fmt: skip
    return figure
