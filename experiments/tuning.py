"""Do parameters chosen from the records alone replay well in the plane?

    python experiments/tuning.py [results/large/grid] [--held-out 2] [--out results/tuning]

Takes a study over θ_I, θ_τ and σ that was run with several sets of demonstrations, such as that of
`experiments/large.sh`. Each cell of the grid has the success rate of a robot with such parameters,
over all sets. The cell's parameters are also scored without any robot: some demonstrations of each
set are left out in turn and filtered with the others (as `jaxreplay tune` does). Scores, each the
larger the better and averaged over sets:

- the error of the predicted commands (root mean square, in % of the commands' ranges), negated;
- that error where the records disagree: in the half of the steps at which their commands differ
  most, at the same share of each record;
- that error where the left-out record's sensors drift, by up to 10 % of their ranges at its end;
- that error where the left-out record is a tenth slower than it was;
- the log evidence of its observations, per time step; and of those made while the robot moves.

The table compares how each score ranks the cells with how success ranks them, and lists the success
of the cell that each score picks. Cells without a finished run are skipped.
"""

import argparse
import warnings
from concurrent.futures import ThreadPoolExecutor
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
from sets import open_sets

from jaxreplay.figures.table import rate, short
from jaxreplay.filter.options import options_of
from jaxreplay.loop.tracker import Tracker
from jaxreplay.machine import cores, keep_compiled
from jaxreplay.params import Params
from jaxreplay.recordings.scores import command_scale, leave_out, sensor_span
from jaxreplay.records import Records
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.open import config_of, open_study
from jaxreplay.study.runs import records_of, runs_of, settings_of

RESAMPLES = 2000
DRIFT = 0.1  # of a sensor's range, at the end of a record
SLOWER = 1.1
EVIDENCES = ("log evidence", "… while it moves")  # scores that are no errors of commands


class Cells(NamedTuple):
    """The C cells of a study that have runs.

    Attributes:
        params: `[C]`-batched parameters.
        sigma: `[C]` σ as a share of the sensors' ranges.
        won: `[sets, C]` successes.
        runs: `[sets, C]` runs finished.
        scores: by name, `[C]` each, the larger the better.
    """

    params: Params
    sigma: np.ndarray
    won: np.ndarray
    runs: np.ndarray
    scores: dict[str, np.ndarray]


def main():
    """Score, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("studies", type=Path, nargs="?", default=Path("results/large/grid"))
    parser.add_argument("--held-out", type=int, default=2, help="demonstrations of each set")
    parser.add_argument("--out", type=Path, default=Path("results/tuning"))
    options = parser.parse_args()
    if options.held_out < 1:
        parser.error(f"--held-out must be at least 1; got {options.held_out}")
    keep_compiled()
    try:
        cells = scored(options.studies, options.held_out)
    except (FileNotFoundError, ValueError) as error:
        parser.error(str(error))
    options.out.mkdir(parents=True, exist_ok=True)
    print(report(cells))
    for suffix in ("png", "pdf"):
        figure(cells, options.out / f"tuning.{suffix}")
    print(f"{options.out}: tuning.png and tuning.pdf")


def scored(folder: Path, held_out: int) -> Cells:
    """Score the cells of the studies in a folder's subfolders, one for each set."""
    outcome = open_sets(folder).outcome
    won, runs = (
        test.sum(["position", "repeat"]).values.reshape(outcome.sizes["seed"], -1)
        for test in (outcome == "S", outcome != "")
    )
    done = np.flatnonzero(runs.all(axis=0))
    if len(done) == 0:
        raise ValueError(f"{folder}: none of its cells has runs with every set")
    scores = []
    for seed in outcome.seed.values:
        config = config_of(open_study(folder / f"{seed}"))
        if apart := {"jump", "light", "records"} & config.axes.keys():
            raise ValueError(
                f"{folder}: its cells differ in {', '.join(apart)}, so their scores cannot be "
                "compared"
            )
        each = runs_of(config)
        first = each.of(np.flatnonzero((each.position == 0) & (each.repeat == 0))).of(done)
        taught = demonstrations(config, folder / f"{seed}")
        params, *_ = settings_of(config, taught, first)
        records = records_of(config, taught, first)
        chosen = np.unique(np.linspace(0, records.n_records - 1, held_out).round().astype(int))
        scores.append(scores_of(records, params, str(first.values["jump"][0]), chosen))
        print(f"{len(scores)} of {len(outcome.seed)} sets", flush=True)
    return Cells(
        params=params,
        sigma=first.values["sigma"],
        won=won[:, done],
        runs=runs[:, done],
        scores={name: np.mean([each[name] for each in scores], axis=0) for name in scores[0]},
    )


def scores_of(records: Records, params: Params, jump: str, chosen) -> dict[str, np.ndarray]:
    """Return the scores of C parameters by the records `chosen`, each left out: `[C]` by name."""
    sensors, commands = records.sequences()
    disagree = disagreement(commands, command_scale(records))
    found: dict[str, list[np.ndarray]] = {}

    def of(i: int) -> dict[str, np.ndarray]:
        z, v = sensors[i], commands[i]
        share = np.linspace(0, 1, len(z))
        apart = np.interp(share, np.linspace(0, 1, len(disagree)), disagree)
        drifting = z + DRIFT * share[:, None] * sensor_span(records)
        slow = np.linspace(0, len(z) - 1, round(SLOWER * len(z))).round().astype(int)
        square, evidence = predicted(records, params, jump, i, z, v)
        return {
            "command error": square,
            "… where records disagree": square[apart > np.median(disagree)],
            "… with drifting sensors": predicted(records, params, jump, i, drifting, v)[0],
            "… a tenth slower": predicted(records, params, jump, i, z[slow], v[slow])[0],
            "log evidence": evidence,
            "… while it moves": evidence[(v[:, :2] != 0).any(axis=1)],
        }

    with ThreadPoolExecutor(cores()) as threads:
        for one in threads.map(of, chosen):
            for name, values in one.items():
                found.setdefault(name, []).append(values)
    means = {name: np.concatenate(each).mean(axis=0) for name, each in found.items()}
    return {n: m if n in EVIDENCES else -100 * np.sqrt(m) for n, m in means.items()}


def predicted(records: Records, params: Params, jump: str, i: int, z, v):
    """Filter observations `[T, n_s]` of the i-th record with the others, and compare commands.

    Returns:
        The mean square errors of the commands predicted for each step, as shares of the commands'
        ranges, and the log evidence of each step, both `[T, C]`.
    """
    scale, n = command_scale(records), len(params.theta_i)
    tracker, everyone = Tracker(leave_out(records, i), params, options_of(jump)), np.ones(n, bool)
    square, evidence = [], []
    for seen, sent in zip(z, v, strict=True):
        square.append(np.sum((scale * (tracker.command - sent)) ** 2, axis=1))
        evidence.append(tracker.observe(np.broadcast_to(seen, (n, len(seen))), everyone)[0])
    return np.array(square), np.array(evidence)


def disagreement(commands: list[np.ndarray], scale: np.ndarray) -> np.ndarray:
    """Return how much the records' commands differ at the same share of each, `[101]`."""
    at = [rows[np.linspace(0, len(rows) - 1, 101).round().astype(int)] for rows in commands]
    return np.sqrt(np.sum((scale * np.std(at, axis=0)) ** 2, axis=1))


def report(cells: Cells) -> str:
    """Return the table: how well scores rank the cells, and which cells they pick."""
    won, runs = cells.won.sum(axis=0), cells.runs.sum(axis=0)
    success = won / runs
    lines = [
        f"{len(success)} cells, of {runs.min()} to {runs.max()} runs each, "
        f"with {len(cells.won)} sets of demonstrations",
        "",
        f"{'picked by':28}{'ρ':>6}{'95 %':>16}{'S, %':>15}{'θ_I':>10}{'θ_τ':>8}{'σ':>8}",
    ]
    for name, score in cells.scores.items():
        rho, low, high = correlation(score, success)
        agrees = f"{rho:6.2f}" + f"[{low:.2f}, {high:.2f}]".rjust(16)
        lines.append(f"{name:28}{agrees}{_cell(cells, np.argmax(score))}")
    if len(cells.won) > 1:
        halves = [cells.won[k::2].sum(axis=0) / cells.runs[k::2].sum(axis=0) for k in (0, 1)]
        rho, low, high = correlation(*halves)
        lines.append(f"{'success with other sets':28}{rho:6.2f}{f'[{low:.2f}, {high:.2f}]':>16}")
    order = np.argsort(success, kind="stable")
    for name, k in (("the median cell", order[len(order) // 2]), ("the best cell", order[-1])):
        lines.append(f"{name:28}{'':22}{_cell(cells, k)}")
    return "\n".join(
        [
            *lines,
            "",
            "ρ: Spearman's, between score and success over the cells; 1 if the score ranks them as",
            "success does (a small error ranks high). Its interval: bootstrap over cells. Success",
            "with other sets: that of every other set, ranked by the rest. S: with Wilson's 95 %",
            "interval; the best of many cells is the best in part by luck.",
        ]
    )


def _cell(cells: Cells, k: int) -> str:
    theta_i, theta_tau = (float(x[k]) for x in (cells.params.theta_i, cells.params.theta_tau))
    values = short(theta_i).rjust(10) + short(theta_tau).rjust(8) + short(cells.sigma[k]).rjust(8)
    return rate(cells.won[:, k].sum(), cells.runs[:, k].sum()).rjust(15) + values


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
    success = 100 * cells.won.sum(axis=0) / cells.runs.sum(axis=0)
    with plt.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        drawn, panels = plt.subplots(2, 3, figsize=(8, 5), sharey=True, layout="constrained")
        for ax, (name, score) in zip(panels.flat, cells.scores.items(), strict=True):
            of_commands = name not in EVIDENCES
            shown = -score if of_commands else score
            points = ax.scatter(
                shown, success, s=14, c=cells.sigma, norm=LogNorm(), cmap="cividis",
                edgecolors="black", linewidths=0.3, alpha=0.8,
            )  # fmt: skip
            best = np.argmax(score)
            ax.plot(
                shown[best], success[best], "o", ms=10, mfc="none", mec="black", label="picked",
                clip_on=False,
            )  # fmt: skip
            ax.set_title(
                f"{name}: ρ = {correlation(score, success)[0]:.2f}", loc="left", fontsize=8
            )
            ax.set_xlabel("% of range; axis reversed" if of_commands else "a time step")
            if of_commands:
                ax.invert_xaxis()  # better is to the right, as for the evidence
            ax.set_ylim(-4, 104)
        for ax in panels[:, 0]:
            ax.set_ylabel(f"S, % of {cells.runs.sum(axis=0).max()} runs")
        panels[0, 0].legend(frameon=False)
        drawn.colorbar(points, ax=panels, label="σ, share of the sensor's range")
        drawn.savefig(path, dpi=150)
        plt.close(drawn)


if __name__ == "__main__":
    main()
