"""Findings on sudden changes: spikes, which are gone after a row or two, and jumps, which stay."""

from collections.abc import Iterator, Set

import numpy as np

from jaxreplay.filter.steps import LAST_STEPS
from jaxreplay.recordings.findings.finding import FEW, Column, Finding, others

# A jump is a step of more than 4 times the median over records of their largest step. A sensor
# steps far when something comes into its range: on the plane the camera by up to 2.1 times that
# median, the proximeters by up to 1.2 (20 demonstrations with each of the seeds 0 to 5). Commands
# may step as they like: a gripper that closes early is no error.
JUMP = 4
# A spike is a step that is taken back within 2 rows, and more than 5 times the median over records
# of their fifth-largest step (the fifth largest, because one event in a record makes fewer than
# five large steps). Nothing that comes into range leaves it so soon: on the plane the largest step
# taken back is 2.1 times that median for sensors, and 2 times for commands (seeds 0 to 3).
SPIKE, SPIKE_ROWS, OFTEN = 5, 2, 5


def leaps(
    rows: list[np.ndarray], k: int, column: Column, known: Set[tuple[int, int]] = frozenset()
) -> Iterator[Finding]:
    """Find spikes of a column, and jumps of a sensor.

    Args:
        rows: N arrays `[L_i, n_s + n_u]`.
        k: the column's index.
        column: its summary.
        known: record and row of steps that another finding names.
    """
    steps = {i: _steps(r[:, k], i, known) for i, r in enumerate(rows) if len(r) >= LAST_STEPS}
    moving = {i: d for i, d in steps.items() if d.any()}
    if not moving:
        return
    often = np.median([np.sort(np.abs(d))[-OFTEN] for d in moving.values()])
    largest = np.median([np.abs(d).max() for d in moving.values()])
    spikes: dict[tuple[int, int], float] = {}  # size by record and row
    jumps: dict[tuple[int, int], float] = {}
    jumping = column.kind == "sensor" and len(moving) >= FEW
    for i, d in moving.items():
        ahead = np.pad(d, (0, SPIKE_ROWS))[1:]
        back = np.lib.stride_tricks.sliding_window_view(ahead, SPIKE_ROWS)
        taken_back = np.minimum(np.abs(d), (-np.sign(d)[:, None] * back).max(axis=1))
        spiky = (taken_back > SPIKE * often) & (often > 0)
        # The steps that begin and end a spike are reported as the spike, not as jumps too.
        part = np.convolve(spiky, np.ones(SPIKE_ROWS + 1))[: len(d)] > 0
        jump = (np.abs(d) > JUMP * largest) & ~part & jumping
        for found, where in ((spikes, spiky), (jumps, jump)):
            found.update({(i, int(t) + 1): abs(d[t]) for t in np.flatnonzero(where)})
    glitch = {
        "sensor": "a glitch? smooth it in the recording",
        "command": "a glitch, which a replay would send? smooth it in the recording",
    }[column.kind]
    jumped = "an error, or a gap in the recording? correct it, cut there, or leave the record out"
    for found, verb, usual, rank, remedy in (
        (spikes, "has a spike of", often, "fifth-largest", glitch),
        (jumps, "jumps by", largest, "largest", jumped),
    ):
        if found:
            i, t = at = max(found, key=found.__getitem__)
            yield Finding(
                f"{column.kind} {column.name} {verb} {found[at]:.3g} at record {i}, row {t}"
                f"{others(found)}, "
                f"{found[at] / usual:.2g} times the median record's {rank} step: {remedy}",
                tuple(sorted({j for j, _ in found})),
                k,
                at,
            )


def _steps(values: np.ndarray, i: int, known: Set[tuple[int, int]]) -> np.ndarray:
    """Return the steps of record i; 0 for those to and from NaN, and for known ones."""
    steps = np.nan_to_num(np.diff(values))
    steps[[t - 1 for j, t in known if j == i]] = 0
    return steps
