"""Parameters climbed to: scored along the way, told, saved and drawn."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.tuning import SHARES, Scores, climb, leave_one_out, sensor_span

MARKS = 16  # parameters along the climb that all records are left out for
_STYLES = ("-", "--", "-.", ":")


class Tuned(NamedTuple):
    """A climb of K steps.

    Attributes:
        path: `[K + 1]`-batched parameters, from the start on.
        marks: `[M]` the steps after which scores were taken, ascending from 0.
        scores: of those M sets of parameters.
        jump: the reading of a jump.
        score: what was climbed, one of `SCORES`.
    """

    path: Params
    marks: np.ndarray
    scores: Scores
    jump: str
    score: str

    @property
    def best(self) -> int:
        """Index into the marks: where the score climbed is best. These are the parameters."""
        if self.score == "commands":
            return int(np.argmin(self.scores.command_error))
        return int(np.argmax(self.scores.log_evidence))

    def params(self, mark: int) -> Params:
        """One set, as NumPy holds it."""
        return jax.tree.map(lambda x: np.asarray(x[self.marks[mark]]), self.path)


def tune(
    records: Records,
    start: Params,
    jump: str,
    score: str,
    steps: int,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Tuned:
    """Climb, then leave every record out for parameters along the path, and keep the best.

    The climb sees a few held-out records at a time; the scores are of all of them.

    Args:
        records: N ≥ 2 records.
        start: one set of parameters.
        jump: `"same_tau"` or `"own_tau"`.
        score: to climb, one of `SCORES`.
        steps: of the climb.
        progress: called with what is being done, how much of it is done and its total.

    Raises:
        ValueError: fewer than 2 records, or no command to predict.
    """
    path = []
    for params in climb(records, start, jump, score, steps):
        path.append(params)
        progress("climbing", len(path) - 1, steps)
    path = jax.tree.map(lambda *each: np.stack(each), *path)
    marks = np.unique(np.linspace(0, steps, MARKS).round().astype(int))
    at_marks = jax.tree.map(lambda x: x[marks], path)
    scores = leave_one_out(records, at_marks, jump, None, lambda *n: progress("scoring", *n))
    return Tuned(path, marks, scores, jump, score)


def text(records: Records, tuned: Tuned) -> str:
    """A table of what it was and what it has become."""
    start, end = tuned.params(0), tuned.params(tuned.best)
    least, most = (share * sensor_span(records) for share in SHARES)
    rows = [("θ_I", start.theta_i, end.theta_i, ""), ("θ_τ", start.theta_tau, end.theta_tau, "")]
    for k, name in enumerate(records.sensor_names):
        reached = end.sigma[k] <= 1.01 * least[k], end.sigma[k] >= 0.99 * most[k]
        bound = {(True, False): "the least it may be", (False, True): "the most it may be"}
        rows.append((f"σ {name}", start.sigma[k], end.sigma[k], bound.get(reached, "")))
    n = len(tuned.scores.steps)
    evidence, error = tuned.scores.log_evidence, 100 * tuned.scores.command_error
    about = f"a time step; {n} records, each left out in turn"
    rows.append(("log evidence", evidence[0], evidence[tuned.best], about))
    rows.append(("command error", error[0], error[tuned.best], "% of the commands' ranges"))
    width = max(len(name) for name, *_ in rows)
    lines = [f"{'':{width}}{'start':>10}{'tuned':>10}"]
    lines += [
        f"{name:{width}}{before:10.4g}{after:10.4g}  {about}".rstrip()
        for name, before, after, about in rows
    ]
    if error[tuned.best] > error[0]:
        lines.append(
            "Commands are predicted worse than at the start: give --score commands instead."
        )
    return "\n".join(lines)


def write(records: Records, tuned: Tuned, source: Path, path: Path) -> None:
    """Save the parameters as TOML: `theta_i`, `theta_tau` and a table `sigma` by sensor."""
    params = tuned.params(tuned.best)
    evidence, error = (
        f"{score[0]:.6g} at the start, {score[tuned.best]:.6g} with these"
        for score in tuned.scores[:2]
    )
    lines = [
        f"# Parameters tuned on {json.dumps(str(source), ensure_ascii=False)}",
        f"# for the reading {tuned.jump} of a jump, by {tuned.score}: each of {records.n_records}",
        "# records was left out in turn and filtered with the others.",
        f"# Log evidence a time step: {evidence}.",
        f"# Error of the predicted command: {error}",
        "# (root mean square, as a share of each command's range).",
        f"theta_i = {_number(params.theta_i)}",
        f"theta_tau = {_number(params.theta_tau)}",
        "",
        "[sigma]  # in the sensors' units",
    ]
    for name, sigma in zip(records.sensor_names, params.sigma, strict=True):
        lines.append(f"{json.dumps(name, ensure_ascii=False)} = {_number(sigma)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _number(value: np.ndarray) -> str:
    """In the fewest digits that give the same float again."""
    return repr(float(str(value)))


def draw(records: Records, tuned: Tuned, path: Path) -> None:
    """The curve: scores along the climb, and the way the parameters took."""
    steps = np.arange(len(tuned.path.theta_i))
    plain = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    with matplotlib.rc_context(plain):
        figure = Figure(figsize=(9, 5.5), layout="constrained")
        axes = figure.subplots(2, 2, sharex=True)
        (evidence, thetas), (error, sigmas) = axes
        evidence.plot(tuned.marks, tuned.scores.log_evidence, "o-", ms=3, color="black")
        evidence.set_ylabel("log evidence a time step")
        error.plot(tuned.marks, 100 * tuned.scores.command_error, "o-", ms=3, color="black")
        error.set_ylabel("command error, % of range")
        thetas.semilogy(steps, tuned.path.theta_i, "-", color="black", label="$\\theta_I$")
        thetas.semilogy(steps, tuned.path.theta_tau, "--", color="0.4", label="$\\theta_\\tau$")
        thetas.set_ylabel("probability")
        shares = np.asarray(tuned.path.sigma) / sensor_span(records)
        colours = matplotlib.colormaps["viridis"](np.linspace(0, 0.85, len(records.sensor_names)))
        for k, name in enumerate(records.sensor_names):
            style = _STYLES[k % len(_STYLES)]
            sigmas.semilogy(steps, shares[:, k], style, color=colours[k], label=f"$\\sigma$ {name}")
        sigmas.set_ylabel("σ, share of the sensor's range")
        for ax in axes.flat:
            ax.axvline(tuned.marks[tuned.best], color="0.7", lw=0.8, zorder=0)
        for ax in (thetas, sigmas):
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.yaxis.set_major_formatter("{x:g}")
            ax.yaxis.set_minor_formatter(NullFormatter())
            ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False, fontsize=8)
        for ax in axes[1]:
            ax.set_xlabel("step of the climb")
        n = len(tuned.scores.steps)
        figure.suptitle(
            f"{n} records, each left out in turn; {tuned.jump}, climbed by {tuned.score}; "
            "grey line: the parameters kept",
            fontsize=9,
        )
        figure.savefig(path, dpi=120)
