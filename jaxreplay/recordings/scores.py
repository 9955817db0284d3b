"""Scores of parameters from records alone: filter each record's observations with the others.

Parameters are good if the other records predict the left-out record's commands (the error of the
predicted command) and its observations (the log evidence). The evidence is the probability density
that the model assigns to the observations. It has no maximum where a sensor repeats values exactly:
as σ goes to 0, the density of a repeated value grows without bound, however badly commands are
predicted.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxreplay.filter.belief import DEFAULT_JUMP, Jump
from jaxreplay.filter.options import options_of
from jaxreplay.loop.tracker import Tracker
from jaxreplay.machine import cores
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.records.columns import command_range


class Scores(NamedTuple):
    """How well P sets of parameters explain H left-out records.

    Attributes:
        log_evidence: `[P]` log p(Z_1:T) of all left-out records, per time step.
        command_error: `[P]` root mean square, over all time steps and commands, of the predicted
            command minus the recorded one, as a share of the command's range in the records.
            Commands that never change do not count.
        log_evidence_each: `[P, H]` the log evidence per time step of each left-out record.
        command_error_each: `[P, H]` the command error of each left-out record.
        steps: `[H]` the left-out records' lengths.
    """

    log_evidence: np.ndarray
    command_error: np.ndarray
    log_evidence_each: np.ndarray
    command_error_each: np.ndarray
    steps: np.ndarray


def leave_out(records: Records, i: int) -> Records:
    """Return the records without the i-th.

    The sensors' offset and the padding remain those of all records. So the result has the same
    shapes for every i, and the filter is compiled only once.

    Raises:
        ValueError: there is no record i, or it is the only one.
    """
    if records.n_records < 2:
        raise ValueError("one record cannot be left out: there is only 1; at least 2 are needed")
    if not 0 <= i < records.n_records:
        raise ValueError(f"no record {i}: there are {records.n_records}, counted from 0")
    return records.subset([k for k in range(records.n_records) if k != i])


def leave_one_out(
    records: Records,
    params: Params,
    jump: Jump = DEFAULT_JUMP,
    left_out: Sequence[int] | np.ndarray | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Scores:
    """Filter each left-out record's observations with the others, for many parameters at once.

    Row t of a record is a command and the observation made after it. So the recorded command is
    compared with the one predicted (equation 8) before that row's observation is known.

    Args:
        records: N ≥ 2 records.
        params: `[P]`-batched parameters.
        jump: the reading of a jump, `"same_tau"` or `"own_tau"`.
        left_out: indices of the records to leave out, one at a time; all if None.
        progress: called with the time steps done and their total, by one thread at a time.

    Raises:
        ValueError: fewer than 2 records, or no such record.
    """
    chosen = range(records.n_records) if left_out is None else left_out
    others = [leave_out(records, i) for i in chosen]
    sensors, commands = records.sequences()
    scale = command_scale(records)
    steps = np.array([len(sensors[i]) for i in chosen])
    done, lock = np.zeros(len(steps), int), Lock()
    n = len(params.theta_i)

    def score(h: int) -> tuple[np.ndarray, np.ndarray]:
        tracker = Tracker(others[h], params, options_of(jump))
        everyone, evidence, square = np.ones(n, bool), np.zeros(n), np.zeros(n)
        for z, v in zip(sensors[chosen[h]], commands[chosen[h]], strict=True):
            square += np.sum((scale * (tracker.command - v)) ** 2, axis=1)
            evidence += tracker.observe(np.broadcast_to(z, (n, len(z))), everyone)[0]
            with lock:
                done[h] += 1
                progress(int(done.sum()), int(steps.sum()))
        return evidence, square

    with ThreadPoolExecutor(cores()) as threads:  # one for each core: a step keeps one busy
        evidence, square = np.array(list(threads.map(score, range(len(steps))))).swapaxes(0, 1)
    return Scores(
        log_evidence=evidence.sum(axis=0) / steps.sum(),
        command_error=np.sqrt(square.sum(axis=0) / steps.sum()),
        log_evidence_each=(evidence / steps[:, None]).T,
        command_error_each=np.sqrt(square / steps[:, None]).T,
        steps=steps,
    )


def sensor_span(records: Records) -> np.ndarray:
    """Return each sensor's range in the records, `[n_s]` in its unit; 1 if it never changes."""
    low, high = np.asarray(records.span, float)
    return np.where(high == low, 1.0, high - low)


def default_params(records: Records) -> Params:
    """Return θ_I = 0.1, θ_τ = 0.05, and σ = a tenth of each sensor's range in the records."""
    return Params(jnp.asarray(0.1), jnp.asarray(0.05), jnp.asarray(0.1 * sensor_span(records)))


def command_scale(records: Records) -> np.ndarray:
    """Return the factors `[n_u]` by which errors of commands are multiplied.

        scale_k = 1 / (range_k √m) for the m commands that change, 0 for the others

    So the sum of the squared scaled errors is the mean square error of the m commands, each as a
    share of its range in the records.
    """
    span = np.ptp(command_range(records.commands, records.lengths), axis=0)
    changes = span > 0
    scale = changes / np.where(changes, span, 1.0) / np.sqrt(max(changes.sum(), 1))
    return scale.astype(records.commands.dtype)
