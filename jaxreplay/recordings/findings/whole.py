"""Findings on whole records: their lengths, their ends, and copies."""

from collections.abc import Iterator

import numpy as np

from jaxreplay.filter.steps import LAST_STEPS
from jaxreplay.recordings.findings.clock import is_clock
from jaxreplay.recordings.findings.finding import (
    Column,
    Finding,
    listed,
    measured,
    rows_in_words,
    spans,
)

# A length is unusual if it is off the median by more than 4 standard deviations, as one in 16,000
# normally distributed lengths is, and by more than a quarter of the median: among records of almost
# equal lengths the standard deviation is near 0, so any other length would be many standard
# deviations away.
LENGTH_DEVIATIONS, LENGTH_SHARE = 4, 0.25
NORMAL = 1.4826  # a normal distribution's standard deviation in median absolute deviations
SAME = 1e-6  # of a column's range: values that differ by less are equal up to float32's rounding
# A record ends in motion if over its last 10 rows a sensor changes by at least half of what it
# changes over 10 rows on average, and by at least 0.6 times the sum of its steps there, and in
# their last third by at least half of its share. Noise of a sensor at rest goes back and forth: on
# the plane the camera's comes to at most 0.33 of the sum of its steps (4 sets of demonstrations).
END_PACE, END_DIRECT, END_LATE = 0.5, 0.6, 0.5


def short(rows: list[np.ndarray]) -> Iterator[Finding]:
    """Find records shorter than the last 10 rows that § 2.2.5 tests."""
    found = {i: rows_in_words(len(r)) for i, r in enumerate(rows) if len(r) < LAST_STEPS}
    if found:
        yield Finding(
            f"{listed(found)}: fewer than the {LAST_STEPS} rows that count as a record's end "
            "(section 2.2.5), so a replay may end as it begins; leave out",
            tuple(found),
        )


def lengths(rows: list[np.ndarray]) -> Iterator[Finding]:
    """Find records of an unusual length."""
    sizes = np.array([len(r) for r in rows])
    median = np.median(sizes)
    off = np.abs(sizes - median)
    limit = max(LENGTH_DEVIATIONS * NORMAL * np.median(off), LENGTH_SHARE * median)
    far = {i: rows_in_words(n) for i, n in enumerate(sizes) if off[i] > limit and n >= LAST_STEPS}
    if far:
        yield Finding(
            f"{listed(far)}: the median length is {median:g} rows; is the whole task recorded, "
            "and nothing else? cut or leave out",
            tuple(far),
        )


def ends(rows: list[np.ndarray], columns: list[Column]) -> Iterator[Finding]:
    """Find records in which sensors move up to the last row."""
    n = LAST_STEPS - 1  # steps
    moving: dict[int, list[str]] = {}
    for k, column in enumerate(columns):
        if column.kind != "sensor" or is_clock(rows, k):  # a clock never rests
            continue
        usual = measured(np.concatenate([np.abs(r[n:, k] - r[:-n, k]) for r in rows]))
        if len(usual) == 0 or usual.max() == 0:
            continue
        for i, r in enumerate(rows):
            if len(r) <= LAST_STEPS:
                continue
            end = r[-LAST_STEPS:, k]
            change, path = end[-1] - end[0], np.abs(np.diff(end)).sum()
            late = np.sign(change) * (end[-1] - end[-1 - n // 3])
            # A comparison with NaN is false.
            if (
                abs(change) >= max(END_PACE * usual.mean(), END_DIRECT * path)
                and late >= END_LATE / 3 * abs(change) > 0
            ):
                moving.setdefault(i, []).append(column.name)
    if moving:
        which = "every record" if len(moving) == len(rows) else listed(dict.fromkeys(moving, ""))
        names = list(dict.fromkeys(name for each in moving.values() for name in each))
        first = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        yield Finding(
            f"{which}: still in motion at the end (sensor{'s' * (len(names) > 1)} {first}); a "
            f"replay ends within a record's last {LAST_STEPS} rows (section 2.2.5), so it would "
            f"stop that far before the goal: let records go on at rest for {LAST_STEPS} rows, or "
            "replay with last_steps=1",
            () if len(moving) == len(rows) else tuple(sorted(moving)),
        )


def copies(rows: list[np.ndarray]) -> Iterator[Finding]:
    """Find records that are the same as another, or as its beginning."""
    near = SAME * spans(rows)
    long = [i for i, r in enumerate(rows) if len(r) >= LAST_STEPS]
    found: dict[int, dict[int, str]] = {}  # of each record, its copies and what they lack
    for i in sorted(long, key=lambda i: -len(rows[i])):
        n = len(rows[i])
        for j in found:
            # The last row is compared first: one row tells most pairs apart, a whole record is
            # hundreds of them.
            if _same(rows[i][-1], rows[j][n - 1], near) and _same(rows[i], rows[j][:n], near):
                found[j][i] = "" if n == len(rows[j]) else rows_in_words(n)
                break
        else:
            found[i] = {}
    for j, again in found.items():
        if again:
            yield Finding(
                f"{listed(again)}: the same as record {j}, row by row; the filter would count "
                "one demonstration as several: keep one",
                tuple(sorted([*again, j])),
            )


def _same(a: np.ndarray, b: np.ndarray, near: np.ndarray) -> bool:
    return bool(np.all((np.abs(a - b) <= near) | (np.isnan(a) & np.isnan(b))))
