"""A finding on sensors that show the time."""

from collections.abc import Iterator

import numpy as np

from jaxreplay.filter.steps import LAST_STEPS
from jaxreplay.recordings.findings.finding import Column, Finding, measured

# A clock increases with every row, by steps that deviate by less than a tenth of their mean, and in
# all records at paces, or by totals, that deviate by less than a tenth.
STEADY = 0.1


def clock(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Find a sensor that shows the time."""
    if is_clock(rows, k):
        yield Finding(
            f"sensor {column.name} increases steadily in every record, as a clock does: the filter "
            "would follow time rather than the situation; leave it out unless that is meant",
            column=k,
        )


def is_clock(rows: list[np.ndarray], k: int) -> bool:
    """Return whether a column grows steadily, in two records or more and in all of them alike."""
    steps = [measured(np.diff(r[:, k])) for r in rows if len(r) >= LAST_STEPS]
    steps = [d for d in steps if len(d)]
    if len(steps) < 2 or any(d.min() <= 0 or d.std() >= STEADY * d.mean() for d in steps):
        return False
    paces, totals = np.array([(d.mean(), d.sum()) for d in steps]).T
    return bool(min(np.ptp(x) / x.mean() for x in (paces, totals)) < STEADY)
