"""Findings on how well the other records predict each record's commands."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import numpy as np

from jaxreplay.params import Params
from jaxreplay.recordings.findings.finding import FEW, Finding, listed
from jaxreplay.recordings.scores import Scores, default_params, leave_one_out
from jaxreplay.records import Records

# A record's command error is unusual if it is more than 1.8 times the upper quartile of all
# records' errors, and above 1 % of the commands' range. On the plane it is at most 1.6 times that
# (seeds 0 to 3). The median is no measure: records at the edge of those demonstrated are predicted
# worse, which in small sets comes to 3 times the median. Of three records it is taken all the same,
# as the quartile would contain the bad one.
FAR, FAR_ERROR = 1.8, 0.01
# A record is unlike the others if its log evidence is this much below their median, in nats per
# row. On the plane the lowest of 20 is 0.9 below it (seeds 0 to 2), of 4 up to 16.
UNLIKE = 20.0
BAD = 0.1  # share of records whose lowest and highest values do not count for σ, at least one
SHIFTS = {-1: "late", 1: "early"}  # of commands by so many rows, and what they are unshifted
SHIFTED_RECORDS = 10  # at most so many are left out to compare shifts, evenly spread
# A shift must reduce the command error by so much of it. Later commands are often a little easier
# to predict, as more observations precede them: on the plane by at most 1.1 % of the error (seeds 0
# to 3), in MountainCarContinuous by 5 %. With each command beside the observation that it answers,
# which is a row early, it was 19 % there, and 12 % for a controller of a noisy plant. Where
# commands change little from row to row, no shift shows. Random commands that a sensor shows at
# once gain up to 22 % although they are right, so the finding says so.
SHIFT_GAIN = 0.1


class Prediction(NamedTuple):
    """How well the other records predict each of N ≥ 3 records, with default parameters.

    Attributes:
        scores: of one set of parameters and N left-out records.
        shifted: command error with commands one row earlier (−1), as they are (0), and one row
            later (+1), of the same records each.
    """

    scores: Scores
    shifted: dict[int, float]


def predict(
    records: Records, progress: Callable[[int, int], None] = lambda done, total: None
) -> Prediction | None:
    """Score each record by the others, and at most 10 with commands shifted; None if N < 3.

    Args:
        records: N records.
        progress: called with the time steps done and their total.
    """
    n = records.n_records
    if n < FEW:
        return None
    params = jax.tree.map(lambda x: np.asarray(x)[None], _params(records))
    lengths = np.asarray(records.lengths)
    some = np.unique(np.linspace(0, n - 1, SHIFTED_RECORDS).round().astype(int))
    first, each = int(lengths.sum()), int(lengths[some].sum())
    total = first + each * len(SHIFTS)
    scores = leave_one_out(records, params, progress=lambda done, _: progress(done, total))
    errors = scores.command_error_each[0]
    shifted = {0: _together(errors[some], lengths[some])}
    for k, shift in enumerate(SHIFTS):
        before = first + k * each
        result = leave_one_out(
            _shift(records, shift),
            params,
            left_out=some,
            progress=lambda done, _, before=before: progress(before + done, total),
        )
        shifted[shift] = float(result.command_error[0])
    return Prediction(scores, shifted)


def unpredicted(prediction: Prediction) -> Iterator[Finding]:
    """Find records whose commands the others predict far worse than usual."""
    errors = prediction.scores.command_error_each[0]
    usual = np.quantile(errors, 0.75 if len(errors) > FEW else 0.5)
    far = np.flatnonzero(errors > max(FAR * usual, FAR_ERROR))
    if len(far):
        yield Finding(
            f"{listed({int(i): f'{errors[i]:.1%}' for i in far})}: the other records predict the "
            f"commands far worse than usual ({usual:.1%} of their range is the "
            f"{'upper quartile' if len(errors) > FEW else 'median'}); columns swapped, other "
            "units, signs flipped, commands shifted, or another task? correct or leave out",
            tuple(far.tolist()),
        )


def unlike(prediction: Prediction) -> Iterator[Finding]:
    """Find records whose observations the others find far less probable than usual."""
    evidence = prediction.scores.log_evidence_each[0]
    usual = float(np.median(evidence))
    far = np.flatnonzero(evidence < usual - UNLIKE)
    if len(far):
        yield Finding(
            f"{listed({int(i): f'{evidence[i]:.1f}' for i in far})}: the other records find the "
            f"observations far less probable than usual (log evidence per row; the median is "
            f"{usual:.1f}); columns swapped, other units, signs flipped, or another task? correct "
            "or leave out",
            tuple(far.tolist()),
        )


def shifted(prediction: Prediction) -> Iterator[Finding]:
    """Find commands that are predicted much better if all are moved by one row."""
    errors = prediction.shifted
    best = min(SHIFTS, key=errors.__getitem__)
    if errors[0] > FAR_ERROR and errors[best] < (1 - SHIFT_GAIN) * errors[0]:
        yield Finding(
            f"commands seem to be one row {SHIFTS[best]}: moved by a row, the other records "
            f"predict them with an error of {errors[best]:.1%} instead of {errors[0]:.1%}; row t "
            "must be the command and the observation made after it; see Records.from_steps (right "
            "as it is where commands are random and the observations after them show that)"
        )


def _params(records: Records) -> Params:
    """Return the default parameters, with σ from a range that a few bad records do not extend.

    One record in other units would otherwise make σ so large that no record could be predicted.
    """
    sensors, _ = records.sequences(filled=True)
    low = np.quantile([x.min(axis=0) for x in sensors], BAD, axis=0, method="higher")
    high = np.quantile([x.max(axis=0) for x in sensors], 1 - BAD, axis=0, method="lower")
    default = default_params(records)
    sigma = np.where(high > low, 0.1 * (high - low), default.sigma)
    return Params(default.theta_i, default.theta_tau, sigma)


def _shift(records: Records, rows: int) -> Records:
    """Return records whose commands are moved by −1 or 1 row.

    The command at the edge is repeated, so that all shapes stay and nothing is compiled again.
    """
    sensors, commands = records.sequences()
    part, edge = (slice(1, None), slice(-1, None)) if rows < 0 else (slice(-1), slice(1))
    moved = [
        np.concatenate([u[part], u[edge]] if rows < 0 else [u[edge], u[part]]) for u in commands
    ]
    return Records.from_sequences(sensors, moved)


def _together(errors: np.ndarray, steps: np.ndarray) -> float:
    """Return the root mean square over all time steps, of that of each record."""
    return float(np.sqrt(np.sum(steps * errors**2) / steps.sum()))
