"""Maps of success: over two factors, or over the cube's position."""

from textwrap import fill

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle

from jaxreplay.figures.outcomes import label, tick_text, title
from jaxreplay.figures.picture import Picture
from jaxreplay.study.dataset import axes_of, cells, is_number, samples_of

COLUMNS = 4  # panels side by side
COLOURS = "cividis"  # lightness grows with the value, also for colour-blind readers and in grey


@matplotlib.rc_context({"font.size": 8})
def factor_map(dataset: xr.Dataset) -> Picture:
    """Draw success over two numeric axes, in a panel for each combination of the others.

    Args:
        dataset: a study with at least two numeric axes; the two with most values are drawn.
    """
    dims = axes_of(dataset)
    numeric = sorted((d for d in dims if is_number(dataset, d)), key=lambda d: -dataset.sizes[d])
    x, y = sorted(numeric[:2], key=dims.index)
    dataset = dataset.sortby([x, y])
    panels = list(cells(dataset, [d for d in dims if d not in (x, y)]))
    figure, axes = _panels(
        len(panels), 0.34 * dataset.sizes[x] + 0.35, 0.27 * dataset.sizes[y] + 0.6
    )
    for k, (ax, (values, runs)) in enumerate(zip(axes, panels, strict=True)):
        rate = _rate(runs.transpose(y, x, ...)).values
        ax.imshow(rate, cmap=COLOURS, vmin=0, vmax=100, origin="lower", aspect="auto")
        for (row, column), value in np.ndenumerate(rate):
            _number(ax, column, row, value)
        ax.set_xticks(
            range(rate.shape[1]), [tick_text(x, v) for v in dataset[x].values], rotation=90
        )
        ax.set_yticks(range(rate.shape[0]), [tick_text(y, v) for v in dataset[y].values])
        if k % COLUMNS:
            ax.tick_params(labelleft=False)
        ax.set_title(_wrapped(figure, title(dataset, values), len(panels)), fontsize=8, loc="left")
    _label_axes(figure, label(dataset, x), label(dataset, y))
    return _finish(figure, axes, panels[0][1])


@matplotlib.rc_context({"font.size": 8})
def position_map(dataset: xr.Dataset) -> Picture:
    """Draw success by the cube's position, in a panel for each cell of the study.

    A dashed rectangle spans the demonstrated positions, if the dataset contains them: a study of a
    file of records does not.

    Args:
        dataset: a study on the plane.

    Raises:
        ValueError: it is one in an environment, which has no positions.
    """
    if "cube_x" not in dataset.coords:
        raise ValueError("a map of positions needs a study on the plane; an environment has none")
    panels = list(cells(dataset, axes_of(dataset)))
    left, ahead = 100 * dataset.cube_y.values, 100 * dataset.cube_x.values
    written = dataset.sizes["repeat"] > 1  # in numbers, for which squares must be large
    step, area = (0.3, 190) if written else (0.15, 55)
    width, height = (step * len(np.unique(at)) + 0.6 for at in (left, ahead))
    figure, axes = _panels(len(panels), width, height)
    for ax, (values, runs) in zip(axes, panels, strict=True):
        rate = _rate(runs, ["repeat"]).values
        ax.scatter(
            left, ahead, s=area, c=rate, marker="s", cmap=COLOURS, vmin=0, vmax=100, linewidths=0
        )
        for x, y, value in zip(left, ahead, rate, strict=True) if written else ():
            _number(ax, x, y, value)
        if "demonstrated_x" in dataset.coords:
            ax.add_patch(_demonstrated(dataset))
        ax.margins(0.12)
        ax.invert_xaxis()  # the robot's left is on the left
        ax.set_title(_wrapped(figure, title(dataset, values), len(panels)), fontsize=8, loc="left")
    if "demonstrated_x" in dataset.coords:
        handles = axes[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper left", frameon=False)
    _label_axes(figure, "cube, to the left of the robot's start, cm", "cube, ahead, cm")
    return _finish(figure, axes, dataset.isel(position=0))


def _demonstrated(dataset: xr.Dataset) -> Rectangle:
    """Return the rectangle around the demonstrated positions, drawn below the numbers."""
    left, ahead = 100 * dataset.demonstrated_y.values, 100 * dataset.demonstrated_x.values
    corner, size = (left.min(), ahead.min()), (np.ptp(left), np.ptp(ahead))
    return Rectangle(corner, *size, fill=False, ls="--", label="demonstrated", zorder=0)


def _panels(n: int, width: float, height: float) -> tuple[Picture, list[Axes]]:
    columns = min(n, COLUMNS)
    rows = -(-n // columns)
    size = (max(columns * width, 3) + 1.2, max(rows * height, 1.8) + 0.7)
    figure = Picture(figsize=size)
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat[n:]:
        ax.remove()
    return figure, list(axes.flat[:n])


def _label_axes(figure: Picture, x: str, y: str):
    """Label both axes, in as many lines as needed."""
    width, height = figure.get_size_inches()
    figure.supxlabel(fill(x, int(14 * (width - 1.2))), fontsize=8)
    figure.supylabel(fill(y, int(14 * (height - 0.7))), fontsize=8)


def _wrapped(figure: Picture, text: str, n: int) -> str:
    """Return the title of one of n panels, in as many lines as the panel's width needs."""
    width = (figure.get_size_inches()[0] - 1.2) / min(n, COLUMNS)
    return fill(text, max(int(16 * width), 12), break_long_words=False)


def _rate(runs: xr.Dataset, over: list[str] | None = None) -> xr.DataArray:
    """Return successes in percent of the finished runs of each cell."""
    over = samples_of(runs) if over is None else over
    finished = (runs.outcome != "").sum(over)
    return 100 * (runs.outcome == "S").sum(over) / finished.where(finished > 0)


def _number(ax: Axes, x: float, y: float, value: float):
    if np.isfinite(value):
        colour = "white" if value < 50 else "black"
        ax.text(x, y, f"{value:.0f}", ha="center", va="center", fontsize=6.5, color=colour)


def _finish(figure: Picture, axes: list[Axes], one: xr.Dataset) -> Picture:
    """Add the colour bar, with the runs behind each rate."""
    n = one.outcome.isel(dict.fromkeys(axes_of(one), 0)).size
    runs = f"{n} runs" if n > 1 else "1 run"
    colours = ScalarMappable(Normalize(0, 100), COLOURS)
    figure.colorbar(colours, ax=axes, label=f"S, % ({runs} each)", fraction=0.05)
    return figure
