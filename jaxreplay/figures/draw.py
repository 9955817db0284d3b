"""The figures that suit a study."""

from pathlib import Path

import matplotlib
import numpy as np
import xarray as xr

from jaxreplay.figures.maps import factor_map, position_map
from jaxreplay.figures.outcomes import figure_3
from jaxreplay.study.dataset import axes_of, is_number

MOST_ROWS = 4  # rows of figure 3, or panels of the plane
MOST_POSITIONS = 12  # without a map of the plane


def draw(dataset: xr.Dataset, folder: Path) -> str:
    """Draw the figures that suit a study, as PNG and PDF, and return the files' names.

    `outcomes` is the paper's figure 3. A study with two numeric axes and too many values for it is
    drawn as a `map` of the two instead. Many positions and few values add `positions`, a map of
    the plane.
    """
    dims = axes_of(dataset)
    sizes = sorted(dataset.sizes[d] for d in dims)
    if np.prod(sizes[:-1]) > MOST_ROWS and sum(is_number(dataset, d) for d in dims) > 1:
        figures = {"map": factor_map}
    else:
        figures = {"outcomes": figure_3}
    if dataset.sizes["position"] > MOST_POSITIONS and np.prod(sizes) <= MOST_ROWS:
        figures["positions"] = position_map
    for name, figure in figures.items():
        for suffix in ("png", "pdf"):
            with matplotlib.rc_context({"font.size": 8}):
                figure(dataset, folder / f"{name}.{suffix}")
    return ", ".join(f"{name}.png and {name}.pdf" for name in figures)
