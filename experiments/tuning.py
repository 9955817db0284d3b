"""Do parameters chosen from the records alone replay well in the plane?

    python experiments/tuning.py [results/grid] [--held-out 4] [--out results/tuning]

Takes a finished study over θ_I, θ_τ and σ, such as that of `experiments/grid.toml`, in which each
cell has the success rate of a robot with such parameters. Each cell's parameters are also scored
without any robot: some of the demonstrations are left out in turn and filtered with the others,
which gives the error of the predicted commands and the log evidence of what was observed (see
`jaxreplay.recordings.scores`; `jaxreplay tune` optimises one or the other). The table compares how
each score ranks the cells with how success ranks them, and lists the success of the cell that each
score picks. Cells without a finished run are skipped.
"""

import argparse
import warnings
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from scipy.stats import (
    ConstantInputWarning,
    DegenerateDataWarning,
    bootstrap,
    pearsonr,
    rankdata,
)
from tqdm import tqdm

from jaxreplay.figures.table import rate, short
from jaxreplay.machine import keep_compiled
from jaxreplay.params import Params
from jaxreplay.recordings.scores import leave_one_out
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.open import config_of, open_study
from jaxreplay.study.runs import records_of, runs_of, settings_of

RESAMPLES = 2000


class Cells(NamedTuple):
    """The C cells of a study that have runs.

    Attributes:
        params: `[C]`-batched parameters.
        sigma: `[C]` σ as a share of the sensors' ranges.
        won: `[C]` successes.
        runs: `[C]` runs finished.
        scores: by name, `[C]` each, the larger the better: log evidence per time step, and minus
            the error of predicted commands in % of their ranges.
    """

    params: Params
    sigma: np.ndarray
    won: np.ndarray
    runs: np.ndarray
    scores: dict[str, np.ndarray]


def main():
    """Score, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path, nargs="?", default=Path("results/grid"))
    parser.add_argument("--held-out", type=int, default=4, help="demonstrations (default: 4)")
    parser.add_argument("--out", type=Path, default=Path("results/tuning"))
    options = parser.parse_args()
    if options.held_out < 1:
        parser.error(f"--held-out must be at least 1; got {options.held_out}")
    keep_compiled()
    try:
        cells = scored(options.study, options.held_out)
    except (FileNotFoundError, ValueError) as error:
        parser.error(str(error))
    options.out.mkdir(parents=True, exist_ok=True)
    print(report(cells))
    for suffix in ("png", "pdf"):
        figure(cells, options.out / f"tuning.{suffix}")
    print(f"{options.out}: tuning.png and tuning.pdf")


def scored(folder: Path, held_out: int) -> Cells:
    """Score the cells of the study in a folder, by held-out demonstrations spread over all."""
    study = open_study(folder)
    config = config_of(study)
    if apart := {"jump", "light", "records"} & config.axes.keys():
        raise ValueError(
            f"{folder}: its cells differ in {', '.join(apart)}, so their scores cannot be compared"
        )
    runs = runs_of(config)
    first = runs.of(np.flatnonzero((runs.position == 0) & (runs.repeat == 0)))  # of each cell
    outcome = study.outcome.values.reshape(len(first), -1)
    done = np.flatnonzero((outcome != "").any(axis=1))
    if len(done) == 0:
        raise ValueError(f"{folder}: none of its runs is finished")
    first, outcome = first.of(done), outcome[done]
    taught = demonstrations(config, folder)
    params, *_ = settings_of(config, taught, first)
    records = records_of(config, taught, first)
    chosen = np.unique(np.linspace(0, records.n_records - 1, held_out).round().astype(int))
    with tqdm(desc=f"{len(done)} cells", unit="step", disable=None) as bar:

        def progress(steps: int, total: int):
            bar.total = total
            bar.update(steps - bar.n)

        scores = leave_one_out(records, params, str(first.values["jump"][0]), chosen, progress)
    return Cells(
        params=params,
        sigma=first.values["sigma"],
        won=np.sum(outcome == "S", axis=1),
        runs=np.sum(outcome != "", axis=1),
        scores={
            "log evidence": scores.log_evidence,
            "command error": -100 * scores.command_error,
        },
    )


def report(cells: Cells) -> str:
    """Return the table: how well scores rank the cells, and which cells they pick."""
    success = cells.won / cells.runs
    lines = [
        f"{len(success)} cells, of {cells.runs.min()} to {cells.runs.max()} runs each",
        "",
        f"{'':28}{'ρ':>6}{'95 %':>16}{'S, %':>15}{'θ_I':>10}{'θ_τ':>8}{'σ':>8}",
    ]
    for name, score in cells.scores.items():
        rho, low, high = correlation(score, success)
        agrees = f"{rho:6.2f}" + f"[{low:.2f}, {high:.2f}]".rjust(16)
        lines.append(f"{f'picked by {name}':28}{agrees}{_cell(cells, np.argmax(score))}")
    order = np.argsort(success, kind="stable")
    for name, k in (("the median cell", order[len(order) // 2]), ("the best cell", order[-1])):
        lines.append(f"{name:28}{'':22}{_cell(cells, k)}")
    return "\n".join(
        [
            *lines,
            "",
            "ρ: Spearman's, between score and success over the cells; 1 if the score ranks them as",
            "success does (a small error ranks high). Its interval: bootstrap over cells. S: with",
            "Wilson's 95 % interval; the best of many cells is the best in part by luck.",
        ]
    )


def _cell(cells: Cells, k: int) -> str:
    theta_i, theta_tau = (float(x[k]) for x in (cells.params.theta_i, cells.params.theta_tau))
    values = short(theta_i).rjust(10) + short(theta_tau).rjust(8) + short(cells.sigma[k]).rjust(8)
    return rate(cells.won[k], cells.runs[k]).rjust(15) + values


def correlation(score: np.ndarray, success: np.ndarray) -> tuple[float, float, float]:
    """Return Spearman's ρ and its 95 % interval by bootstrap; NaN where all cells are alike.

    Resamples of cells that are all alike have no ρ and are left out.
    """
    if len(np.unique(score)) < 2 or len(np.unique(success)) < 2:
        return np.nan, np.nan, np.nan
    with warnings.catch_warnings():
        for of_such_resamples in (ConstantInputWarning, DegenerateDataWarning):
            warnings.simplefilter("ignore", of_such_resamples)
        resampled = bootstrap(
            (score, success), spearman, paired=True, method="percentile", n_resamples=RESAMPLES,
            rng=np.random.default_rng(0),
        )  # fmt: skip
    low, high = np.nanquantile(resampled.bootstrap_distribution, [0.025, 0.975])
    return float(spearman(score, success)), float(low), float(high)


def spearman(x: np.ndarray, y: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return Spearman's ρ along an axis: Pearson's correlation of the ranks."""
    return pearsonr(rankdata(x, axis=axis), rankdata(y, axis=axis), axis=axis).statistic


def figure(cells: Cells, path: Path):
    """Draw success against each score, a point for each cell."""
    success = 100 * cells.won / cells.runs
    shown = {
        "log evidence": (1, "log evidence a time step"),
        "command error": (-1, "error of predicted commands, % of range; axis reversed"),
    }
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        drawn, panels = plt.subplots(1, 2, figsize=(8, 3.4), sharey=True, layout="constrained")
        for ax, (name, score) in zip(panels, cells.scores.items(), strict=True):
            sign, label = shown[name]
            points = ax.scatter(
                sign * score, success, s=22, c=cells.sigma, norm=LogNorm(), cmap="cividis",
                edgecolors="black", linewidths=0.3, alpha=0.8,
            )  # fmt: skip
            best = np.argmax(score)
            ax.plot(
                sign * score[best], success[best], "o", ms=11, mfc="none", mec="black",
                label="picked", clip_on=False,
            )  # fmt: skip
            rho, low, high = correlation(score, success)
            ax.set_title(f"ρ = {rho:.2f} [{low:.2f}, {high:.2f}]", loc="left", fontsize=9)
            ax.set_xlabel(label)
            if sign < 0:
                ax.invert_xaxis()  # better is to the right, as on the left
            ax.set_ylim(-4, 104)
        panels[0].set_ylabel(f"S, % of {cells.runs.max()} runs in the plane")
        panels[0].legend(frameon=False)
        drawn.colorbar(points, ax=panels, label="σ, share of the sensor's range")
        drawn.savefig(path, dpi=150)
        plt.close(drawn)


if __name__ == "__main__":
    main()
