"""The figures that suit a study."""

from pathlib import Path

import numpy as np
import xarray as xr

from jaxreplay.figures.comparison import compares, comparison
from jaxreplay.figures.maps import factor_map, position_map
from jaxreplay.figures.outcomes import figure_3
from jaxreplay.figures.picture import Picture
from jaxreplay.study.dataset import axes_of, is_number

MOST_ROWS = 4  # rows of figure 3, or panels of the plane
MOST_POSITIONS = 12  # without a map of the plane


def figures_of(dataset: xr.Dataset) -> dict[str, Picture]:
    """Return the figures that suit a study, by name; the first is the main one.

    `outcomes` is the paper's figure 3. A study with two numeric axes and too many values for it is
    drawn as a `map` of the two instead; one with a numeric axis and three or more words, such as
    controllers, as a `comparison`. Many positions and few values add `positions`, a map of
    the plane.
    """
    dims = axes_of(dataset)
    few = np.prod([dataset.sizes[d] for d in dims]) <= MOST_ROWS
    figures = main_figure(dataset)
    if dataset.sizes.get("position", 1) > MOST_POSITIONS and few:
        figures["positions"] = position_map(dataset)
    return figures


def main_figure(dataset: xr.Dataset) -> dict[str, Picture]:
    """Return the main figure of a study by its name: `outcomes`, `map` or `comparison`."""
    if compares(dataset):
        return {"comparison": comparison(dataset)}
    dims = axes_of(dataset)
    sizes = sorted(dataset.sizes[d] for d in dims)
    if np.prod(sizes[:-1]) > MOST_ROWS and sum(is_number(dataset, d) for d in dims) > 1:
        return {"map": factor_map(dataset)}
    return {"outcomes": figure_3(dataset)}


def draw(dataset: xr.Dataset, folder: Path) -> str:
    """Save the figures that suit a study, as PNG and PDF, and return the files' names."""
    figures = figures_of(dataset)
    for name, figure in figures.items():
        for suffix in ("png", "pdf"):
            figure.savefig(folder / f"{name}.{suffix}")
    return ", ".join(f"{name}.png and {name}.pdf" for name in figures)
