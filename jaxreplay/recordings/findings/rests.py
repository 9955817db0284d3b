"""Findings on columns that do not change: never, or for unusually long."""

from collections.abc import Iterator

import numpy as np

from jaxreplay.filter.steps import LAST_STEPS
from jaxreplay.recordings.findings.finding import FEW, Column, Finding, listed, measured, span
from jaxreplay.recordings.findings.whole import LENGTH_SHARE

# A sensor is stuck if it keeps one value for more than 3 times the median over records of their
# longest rest, and for more than 20 rows. A sensor rests while it sees nothing, and while the robot
# stands still: on the plane the camera for up to 2.1 times that median, the proximeters for 1.4.
STUCK, STUCK_ROWS = 3, 20
STUCK_SHARE = 0.5  # of a record: the limit instead of that median where records are few


def still(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Find a column that never changes, in all records or in a few."""
    # Records that are much shorter than the others are not counted: what changes the column may
    # come only after they break off.
    whole = max(LAST_STEPS, (1 - LENGTH_SHARE) * np.median([len(r) for r in rows]))
    values = {i: measured(r[:, k]) for i, r in enumerate(rows) if len(r) >= whole}
    values = {i: v for i, v in values.items() if len(v)}
    same = {i: f"{v[0]:.6g}" for i, v in values.items() if np.ptp(v) == 0}
    moving = len(values) - len(same)
    if column.lowest == column.highest:
        effect = {
            "sensor": "it gives the filter no information",
            "command": "a replay can send no other value",
        }
        yield Finding(
            f"{column.kind} {column.name} is {column.lowest:.6g} in every row: "
            f"{effect[column.kind]}; leave it out, or find out why it was not recorded",
            column=k,
        )
    elif same and len(same) <= moving / 2:
        cause = {"sensor": "is the sensor dead", "command": "was the command not recorded"}
        yield Finding(
            f"{column.kind} {column.name} never changes in {listed(same)}, but does in {moving} "
            f"others: {cause[column.kind]}? then leave these records out",
            tuple(same),
            k,
        )


def stuck(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Find rests at one value that are far longer than usual."""
    rests = {i: _longest_rest(r[:, k]) for i, r in enumerate(rows) if span(r[:, k]) > 0}
    usual = np.median([n for n, _ in rests.values()]) if len(rests) >= FEW else None
    found: dict[int, tuple[int, int]] = {}  # rows and the first of them, by record
    for i, (n, t) in rests.items():
        if usual is None:
            # A rest at the end of a sensor's range is no sign: the sensor may see nothing for
            # most of a record.
            inside = column.lowest < rows[i][t, k] < column.highest
            limit = STUCK_SHARE * len(rows[i]) if inside else np.inf
        else:
            limit = STUCK * usual
        if n > max(STUCK_ROWS, limit):
            found[i] = n, t
    if found:
        i = max(found, key=found.__getitem__)
        n, t = found[i]
        also = dict.fromkeys(set(found) - {i}, "")
        more = f" (also in {listed(also)})" if also else ""
        usually = (
            ""
            if usual is None
            else f"; other records keep one value for {usual:g} rows at most (median)"
        )
        yield Finding(
            f"sensor {column.name} stays at {rows[i][t, k]:.6g} for {n} rows from record {i}, row "
            f"{t}{more}{usually}: stuck? cut there or leave out",
            tuple(sorted(found)),
            k,
            (i, t),
        )


def _longest_rest(values: np.ndarray) -> tuple[int, int]:
    """Return the number of rows of the longest run of one value, and the first of them.

    A NaN differs from every value, so that each is a run of its own.
    """
    begins = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [len(values)]])
    lengths = np.diff(begins)
    k = int(np.argmax(lengths))
    return int(lengths[k]), int(begins[k])
