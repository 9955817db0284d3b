"""Parameters chosen from records alone, as text and as a TOML file."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from jaxreplay.filter.belief import DEFAULT_JUMP, Jump
from jaxreplay.machine import write_whole
from jaxreplay.params import Params
from jaxreplay.recordings.optimise import SIGMA_BOUNDS, Score, optimise
from jaxreplay.recordings.scores import Scores, default_params, leave_one_out, sensor_span
from jaxreplay.records import Records

CHECKPOINTS = 16  # sets of parameters along the path that are scored on all records


class Tuned(NamedTuple):
    """The result of K optimisation steps.

    Attributes:
        path: `[K + 1]`-batched parameters: at the start, and after each step.
        checkpoints: `[M]` the steps after which parameters were scored, ascending from 0.
        scores: of the M sets of parameters at the checkpoints.
        jump: the reading of a jump.
        score: the score that was optimised, one of `SCORES`.
    """

    path: Params
    checkpoints: np.ndarray
    scores: Scores
    jump: Jump
    score: Score

    @property
    def best(self) -> int:
        """Index of the checkpoint with the best value of the optimised score."""
        if self.score == "commands":
            return int(np.argmin(self.scores.command_error))
        return int(np.argmax(self.scores.log_evidence))

    def params(self, checkpoint: int) -> Params:
        """Return the parameters at a checkpoint, given its index."""
        return jax.tree.map(lambda x: np.asarray(x[self.checkpoints[checkpoint]]), self.path)


def tune(
    records: Records,
    start: Params | None = None,
    *,
    jump: Jump = DEFAULT_JUMP,
    score: Score = "commands",
    steps: int = 30,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Tuned:
    """Optimise a score, and score parameters along the path with each record left out in turn.

    An optimisation step uses a few left-out records; the scores at the checkpoints are of all.

    Args:
        records: N ≥ 2 records.
        start: one set of parameters; :func:`jaxreplay.recordings.scores.default_params` if None.
        jump: the reading of a jump, `"same_tau"` or `"own_tau"`.
        score: the score to optimise, one of `SCORES`.
        steps: the number of optimisation steps.
        progress: called with the name of the stage, how much of it is done, and its total.

    Raises:
        ValueError: fewer than 2 records, or no command to predict.
    """
    start = default_params(records) if start is None else start
    path = []
    for params in optimise(records, start, jump, score, steps):
        path.append(params)
        progress("optimising", len(path) - 1, steps)
    path = jax.tree.map(lambda *each: np.stack(each), *path)
    checkpoints = np.unique(np.linspace(0, steps, CHECKPOINTS).round().astype(int))
    params = jax.tree.map(lambda x: x[checkpoints], path)
    scores = leave_one_out(records, params, jump, None, lambda *n: progress("scoring", *n))
    return Tuned(path, checkpoints, scores, jump, score)


def summary(records: Records, tuned: Tuned) -> str:
    """Return a table of parameters and scores, at the start and as tuned.

    The row of the score that was optimised says so.
    """
    start, end = tuned.params(0), tuned.params(tuned.best)
    lowest, highest = (share * sensor_span(records) for share in SIGMA_BOUNDS)
    idle = _without_effect(records, tuned.score)
    rows = [
        ("θ_I", start.theta_i, end.theta_i, idle.get("theta_i", "")),
        ("θ_τ", start.theta_tau, end.theta_tau, ""),
    ]
    for k, name in enumerate(records.sensor_names):
        note = idle.get(name, "")
        if not note and end.sigma[k] <= 1.01 * lowest[k]:
            note = "the lowest allowed"
        elif not note and end.sigma[k] >= 0.99 * highest[k]:
            note = "the highest allowed"
        rows.append((f"σ {name}", start.sigma[k], end.sigma[k], note))
    n = len(tuned.scores.steps)
    evidence, error = tuned.scores.log_evidence, 100 * tuned.scores.command_error
    note = f"per time step; {n} records, each left out in turn"
    optimised = {tuned.score: " (optimised)"}
    note += optimised.get("evidence", "")
    rows.append(("log evidence", evidence[0], evidence[tuned.best], note))
    note = "% of the commands' ranges" + optimised.get("commands", "")
    rows.append(("command error", error[0], error[tuned.best], note))
    width = max(len(name) for name, *_ in rows)
    lines = [f"{'':{width}}{'start':>10}{'tuned':>10}"]
    lines += [
        f"{name:{width}}{before:10.4g}{after:10.4g}  {note}".rstrip()
        for name, before, after, note in rows
    ]
    if error[tuned.best] > error[0]:
        lines.append(
            "Commands are predicted worse than at the start: give --score commands instead."
        )
    return "\n".join(lines)


def save(records: Records, tuned: Tuned, source: Path, path: Path) -> None:
    """Write the tuned parameters as TOML: `theta_i`, `theta_tau` and a table `sigma` by sensor.

    Args:
        records: the records.
        tuned: the result of `tune`.
        source: file of the records, named in a comment.
        path: of the TOML file.
    """
    params = tuned.params(tuned.best)
    evidence, error = (
        f"{score[0]:.6g} at the start, {score[tuned.best]:.6g} with these"
        for score in tuned.scores[:2]
    )
    idle = _without_effect(records, tuned.score)
    lines = [
        f"# Parameters tuned on {json.dumps(str(source), ensure_ascii=False)}",
        f"# for the reading {tuned.jump} of a jump, by {tuned.score}: each of {records.n_records}",
        "# records was left out in turn and filtered with the others.",
        f"# Log evidence per time step: {evidence}.",
        f"# Error of the predicted command: {error}",
        "# (root mean square, as a share of each command's range).",
        f"theta_i = {_number(params.theta_i)}{_comment(idle.get('theta_i'))}",
        f"theta_tau = {_number(params.theta_tau)}",
        "",
        "[sigma]  # in the sensors' units",
    ]
    for name, sigma in zip(records.sensor_names, params.sigma, strict=True):
        key = json.dumps(name, ensure_ascii=False)
        lines.append(f"{key} = {_number(sigma)}{_comment(idle.get(name))}")
    write_whole(path, ("\n".join(lines) + "\n").encode())


def _without_effect(records: Records, score: Score) -> dict[str, str]:
    """Return why a parameter has no effect on the optimised score, for each that has none.

    Keys are `theta_i`, and the names of sensors for their σ.
    """
    reasons = {}
    if records.n_records == 2:
        reasons["theta_i"] = "no effect: leaving one of 2 records out leaves one, with no jump"
    low, high = np.asarray(records.span)
    if score == "commands":
        for name in np.array(records.sensor_names)[low == high]:
            reasons[str(name)] = "no effect on the commands: the sensor never changes"
    return reasons


def _comment(reason: str | None) -> str:
    return f"  # {reason}" if reason else ""


def _number(value: np.ndarray | jax.Array) -> str:
    """Return a number in the fewest digits that read back as the same value."""
    return repr(float(str(value)))
