"""The figure of an inspection: all records over time, with the unusual ones marked."""

from collections.abc import Iterable
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from jaxreplay.figures.picture import Picture, literal
from jaxreplay.recordings.inspect import Inspection, table_of
from jaxreplay.records import Records

FORMATS = ("png", "pdf", "svg", "jpg")
OTHERS: dict[str, Any] = {"color": "0.65", "linewidth": 0.4}  # beside marked records
# Each marked record has a dark colour, to stand out from the grey ones, and dashes of its own, by
# which it is recognised in a print without colour.
MARKS: tuple[dict[str, Any], ...] = tuple(
    {"color": colour, "linewidth": 1.2, "linestyle": (0, dashes)}
    for colour, dashes in (
        ("#c0504d", (5, 1)),
        ("#1f4e79", (1, 1)),
        ("#2e6b2e", (6, 1, 1, 1)),
        ("#b35900", (3, 2)),
        ("#5b3b8c", (1, 2.5)),
        ("black", (8, 2, 2, 2)),
    )
)


def inspection_figure(records: Records, inspection: Inspection) -> Picture:
    """Return a figure of records over time, 8 inches wide.

    The first panel shows the lengths; then each sensor and command has one, in its own units. The
    first records that findings name are marked: in the panel of the finding's column, or in all
    panels if the finding concerns whole records. A ring marks the worst case of a finding. Where no
    record is named, each has its own shade, which its bar in the first panel shows too.

    Args:
        records: N records.
        inspection: of these records.
    """
    rows, (lengths, period, columns, findings, _) = table_of(records), inspection
    named = list(dict.fromkeys(i for finding in findings for i in finding.records))
    marks = dict(zip(named, MARKS, strict=False))
    shades = matplotlib.colormaps["viridis"](np.linspace(0, 0.9, len(rows)))
    plain = [OTHERS if named else {"color": shade, "linewidth": 0.6} for shade in shades]
    styles = {i: marks.get(i, plain[i]) for i in range(len(rows))}
    scale, unit = (1, "rows") if period is None else (period, "s")
    used, across = len(columns) + 1, 2 if len(columns) < 6 else 3
    down = -(-used // across)
    figure = Picture(figsize=(8, 1.45 * down + 0.5))
    panels = figure.subplots(down, across, squeeze=False).ravel()
    _lengths(panels[0], scale * lengths, unit, styles, marks)
    for k, (axes, column) in enumerate(zip(panels[1:], columns, strict=False)):
        about = [finding for finding in findings if finding.column in (None, k)]
        shown = {i for finding in about for i in finding.records if i in marks}
        for i in sorted(range(len(rows)), key=lambda i: i in shown):
            values = rows[i][:, k]
            axes.plot(
                scale * np.arange(len(values)), values, marker="" if len(values) > 1 else ".",
                rasterized=True, **(marks[i] if i in shown else plain[i]),
            )  # fmt: skip
        for i, t in (finding.at for finding in about if finding.at):
            colour, point = marks.get(i, {"color": "black"})["color"], (scale * t, rows[i][t, k])
            axes.plot(*point, "o", color=colour, fillstyle="none")
            axes.annotate(
                f"{i}", point, (5, 4), textcoords="offset points", color=colour, fontsize=7
            )
        axes.set_title(literal(f"{column.kind} {column.name}"), loc="left", fontsize=8)
        axes.margins(x=0.02, y=0.12)
        axes.set_xlabel("row" if period is None else "time, s", fontsize=8)
    for axes in panels[:used]:
        axes.tick_params(labelsize=7)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[used:]:
        axes.remove()
    if named:
        keys = [Line2D([], [], **marks[i], label=f"record {i}") for i in marks]
        more = len(named) - len(marks)
        rest = f"others, {more} of them named in the text" if more else "others"
        if len(marks) < len(rows):
            keys.append(Line2D([], [], **OTHERS, label=rest))
        figure.legend(
            handles=keys, loc="outside upper center", ncols=4, frameon=False, fontsize=8,
            handlelength=4,
        )  # fmt: skip
    return figure


def _lengths(
    axes: Axes,
    lengths: np.ndarray,
    unit: str,
    styles: dict[int, dict[str, Any]],
    marks: Iterable[int],
) -> None:
    """Draw the records' lengths as bars in the records' colours, and the numbers of marked ones."""
    axes.bar(range(len(lengths)), lengths, color=[styles[i]["color"] for i in styles])
    axes.axhline(np.median(lengths), color="black", linewidth=0.8, linestyle="--")
    for i in marks:
        axes.annotate(f"{i}", (i, lengths[i]), ha="center", va="bottom", fontsize=7)
    axes.set_title(f"length, {unit} (dashed: median)", loc="left", fontsize=8)
    axes.set_xlabel("record", fontsize=8)
    axes.set_xlim(-0.6, len(lengths) - 0.4)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.margins(y=0.15)
