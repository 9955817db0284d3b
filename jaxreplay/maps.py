"""Maps of success: over two factors, or over where the cube stands. They only read datasets."""

from pathlib import Path
from textwrap import fill

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from jaxreplay.factors import FACTORS
from jaxreplay.figures import figure_3, label, title, write
from jaxreplay.plane.demonstrator import DEMONSTRATED
from jaxreplay.table import axes_of, cells

COLUMNS = 4  # panels side by side
MOST_ROWS = 4  # of figure 3, or panels of the plane
MOST_POSITIONS = 12  # that are taken together
COLOURS = "cividis"  # as light as it is large, to every eye and in grey


def draw(dataset: xr.Dataset, folder: Path) -> str:
    """Draw what suits a study, as PNG and PDF; returns the files' names.

    `outcomes` is the paper's Figure 3; a study with two numbers among its factors and too many
    values for that is a `map` of them instead. Many positions and few values make `positions`, a
    map of the plane, besides.
    """
    dims = axes_of(dataset)
    sizes = sorted(dataset.sizes[d] for d in dims)
    if np.prod(sizes[:-1]) > MOST_ROWS and sum(FACTORS[d].numeric for d in dims) > 1:
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


def factor_map(dataset: xr.Dataset, path: str | Path) -> None:
    """Success over two numeric axes; a panel for each combination of the others.

    Args:
        dataset: a study with at least two numeric axes; the two with most values are drawn.
        path: where to save it, as its suffix says.
    """
    dims = axes_of(dataset)
    numeric = sorted((d for d in dims if FACTORS[d].numeric), key=lambda d: -dataset.sizes[d])
    x, y = sorted(numeric[:2], key=dims.index)
    panels = list(cells(dataset, [d for d in dims if d not in (x, y)]))
    figure, axes = _panels(
        len(panels), 0.34 * dataset.sizes[x] + 0.35, 0.27 * dataset.sizes[y] + 0.6
    )
    for k, (ax, (values, runs)) in enumerate(zip(axes, panels, strict=True)):
        rate = _rate(runs.transpose(y, x, ...)).values
        image = ax.imshow(rate, cmap=COLOURS, vmin=0, vmax=100, origin="lower", aspect="auto")
        for (row, column), value in np.ndenumerate(rate):
            _number(ax, column, row, value)
        ax.set_xticks(range(rate.shape[1]), [write(x, v) for v in dataset[x].values], rotation=90)
        ax.set_yticks(range(rate.shape[0]), [write(y, v) for v in dataset[y].values])
        if k % COLUMNS:
            ax.tick_params(labelleft=False)
        ax.set_title(title(values), fontsize=8)
    _name(figure, label(x), label(y))
    _finish(figure, axes, image, panels[0][1], path)


def position_map(dataset: xr.Dataset, path: str | Path) -> None:
    """Success by where the cube stands; a panel for each cell of the study."""
    panels = list(cells(dataset, axes_of(dataset)))
    left, ahead = 100 * dataset.cube_y.values, 100 * dataset.cube_x.values
    told = dataset.sizes["repeat"] > 1  # in numbers, for which squares must be large
    step, area = (0.3, 190) if told else (0.15, 55)
    width, height = (step * len(np.unique(at)) + 0.6 for at in (left, ahead))
    figure, axes = _panels(len(panels), width, height)
    low, high = 100 * DEMONSTRATED.min(axis=0), 100 * DEMONSTRATED.max(axis=0)
    for ax, (values, runs) in zip(axes, panels, strict=True):
        rate = _rate(runs, "repeat").values
        image = ax.scatter(
            left, ahead, s=area, c=rate, marker="s", cmap=COLOURS, vmin=0, vmax=100, linewidths=0
        )
        for x, y, value in zip(left, ahead, rate, strict=True) if told else ():
            _number(ax, x, y, value)
        size = (high - low)[::-1]
        ax.add_patch(  # under the numbers
            Rectangle(low[::-1], *size, fill=False, ls="--", label="demonstrated", zorder=0)
        )
        ax.invert_xaxis()  # the robot's left is on the left
        ax.set_title(title(values), fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", frameon=False)
    _name(figure, "cube, to the left of the robot's start, cm", "cube, ahead, cm")
    _finish(figure, axes, image, dataset.isel(position=0), path)


def _panels(n: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    columns = min(n, COLUMNS)
    rows = -(-n // columns)
    size = (max(columns * width, 3) + 1.2, max(rows * height, 1.8) + 0.7)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat[n:]:
        ax.remove()
    return figure, list(axes.flat[:n])


def _name(figure: Figure, x: str, y: str):
    """Both axes, in as many lines as it takes."""
    width, height = figure.get_size_inches()
    figure.supxlabel(fill(x, int(14 * (width - 1.2))), fontsize=8)
    figure.supylabel(fill(y, int(14 * (height - 0.7))), fontsize=8)


def _rate(runs: xr.Dataset, over=("position", "repeat")) -> xr.DataArray:
    """Successes in percent of the runs that are finished."""
    finished = (runs.outcome != "").sum(over)
    return 100 * (runs.outcome == "S").sum(over) / finished.where(finished > 0)


def _number(ax: Axes, x: float, y: float, value: float):
    if np.isfinite(value):
        colour = "white" if value < 50 else "black"
        ax.text(x, y, f"{value:.0f}", ha="center", va="center", fontsize=6, color=colour)


def _finish(figure: Figure, axes: list[Axes], image, one: xr.Dataset, path: str | Path):
    n = one.outcome.isel(dict.fromkeys(axes_of(one), 0)).size
    runs = f"{n} runs" if n > 1 else "1 run"
    figure.colorbar(image, ax=axes, label=f"S, % ({runs} each)", fraction=0.05)
    figure.savefig(path, dpi=150)
