"""Figures; they only read datasets."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from jaxreplay.replay import OUTCOMES
from jaxreplay.study import standard_error

# From light to dark, hatched besides, so that they are told apart in grey.
COLOURS = {"S": "#cfe8cf", "Fs": "#f2b872", "Fg": "#c0504d", "Fb": "#3b3b58"}
HATCHES = {"S": "", "Fs": "//", "Fg": "..", "Fb": "xx"}
MEANINGS = {"S": "success", "Fs": "over 3 minutes", "Fg": "no grasp", "Fb": "left the area"}
READINGS = {
    "same_tau": "a jump keeps the moment τ (same_tau)",
    "own_tau": "a jump lands where the record stands (own_tau)",
}
STYLES = (  # variable, label, marker, colour, its face, and how far beside the tick
    ("alignment_error", "alignment error, mm (●)", "o", "#1f4e79", "#1f4e79", -0.12),
    ("duration", "run duration, s (□)", "s", "#b35900", "white", 0.12),
)


def figure_3(dataset: xr.Dataset, path: str | Path) -> None:
    """Figure 3 of the paper, a row for each reading of a jump; saved as the path's suffix says."""
    n = dataset.sizes["jump"]
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "hatch.linewidth": 0.5}):
        figure, rows = plt.subplots(
            n, 2, figsize=(8, 2.7 * n + 0.5), squeeze=False, sharex=True, layout="constrained"
        )
        won = dataset.where(dataset.outcome == "S")
        tops = [1.1 * np.nan_to_num(won[name].max().item(), nan=1) for name, *_ in STYLES]
        for axes, jump in zip(rows, dataset.jump.values, strict=True):
            runs = dataset.sel(jump=jump)
            _outcomes(axes[0], runs)
            _error_and_duration(axes[1], runs, tops)
            axes[0].set_title(READINGS[str(jump)], loc="left", fontsize=9)
        for axes in rows[-1]:
            axes.set_xlabel("$\\theta_I$, probability to jump to another record")
        handles, labels = rows[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
        figure.savefig(path, dpi=150)
        plt.close(figure)


def _theta_axis(axes: plt.Axes, theta_i: np.ndarray):
    axes.set_xticks(range(len(theta_i)), [_power(value) for value in theta_i])
    axes.set_xlim(-0.6, len(theta_i) - 0.4)


def _power(value: float) -> str:
    return "0" if value == 0 else f"$10^{{{np.log10(value):.3g}}}$"


def _outcomes(axes: plt.Axes, runs: xr.Dataset):
    counts = {o: (runs.outcome == o).sum(("position", "repeat")).values for o in OUTCOMES}
    total = sum(counts.values())
    bottom = np.zeros(len(total))
    for outcome, count in counts.items():
        share = 100 * count / total
        axes.bar(
            range(len(total)), share, 0.75, bottom,
            label=f"{outcome}: {MEANINGS[outcome]}",
            color=COLOURS[outcome], hatch=HATCHES[outcome], edgecolor="black", linewidth=0.5,
        )  # fmt: skip
        bottom += share
    axes.set_ylabel(f"runs, % (of {total[0]} each)")
    axes.set_ylim(0, 100)
    axes.spines["right"].set_visible(False)
    _theta_axis(axes, runs.theta_i.values)


def _error_and_duration(axes: plt.Axes, runs: xr.Dataset, tops: list[float]):
    sides = axes, axes.twinx()
    for ax, (name, label, marker, colour, face, shift), top in zip(
        sides, STYLES, tops, strict=True
    ):
        for k, theta_i in enumerate(runs.theta_i.values):
            cell = runs.sel(theta_i=theta_i)
            values = cell[name].values[cell.outcome.values == "S"]
            if len(values):
                error = standard_error(values) if len(values) > 1 else None
                ax.errorbar(
                    k + shift, values.mean(), error, fmt=marker, color=colour,
                    markersize=5, capsize=3, markerfacecolor=face,
                )  # fmt: skip
            elif ax is axes:
                ax.text(k, 0.02 * top, "none", ha="center", fontsize=7, color="grey")
        ax.set_ylabel(label, color=colour)
        ax.set_ylim(0, top)
    axes.set_title("successful runs: mean ± standard error", loc="right", fontsize=8)
    _theta_axis(axes, runs.theta_i.values)
