"""What is unusual in records, a file for each subject.

Unusual is what lies far from the median over the same records: a few bad records hardly move a
median, and no limit depends on a sensor's unit. Functions take the table of rows, an array
`[L_i, n_s + n_u]` for each record, in which NaN marks a value that was not measured.
"""

from collections.abc import Iterator

import numpy as np

from jaxreplay.recordings.findings.angles import flips, wraps
from jaxreplay.recordings.findings.clock import clock
from jaxreplay.recordings.findings.finding import Column, Finding
from jaxreplay.recordings.findings.leaps import leaps
from jaxreplay.recordings.findings.missing import missing
from jaxreplay.recordings.findings.rests import still, stuck
from jaxreplay.recordings.findings.whole import copies, ends, lengths, short


def findings_of(rows: list[np.ndarray], columns: list[Column]) -> Iterator[Finding]:
    """Yield what is unusual, whole records first, then column by column.

    Args:
        rows: N arrays `[L_i, n_s + n_u]`.
        columns: their n_s sensors, then their n_u commands.
    """
    yield from short(rows)
    yield from lengths(rows)
    yield from ends(rows, columns)
    yield from copies(rows)
    flipped, explained = flips(rows, columns)
    yield from flipped
    for k, column in enumerate(columns):
        yield from missing(rows, k, column)
        yield from still(rows, k, column)
        known = explained.get(k, set())
        if column.kind == "sensor":
            yield from clock(rows, k, column)
            wrapped, at = wraps(rows, k, column)
            yield from wrapped
            known = known | at
        yield from leaps(rows, k, column, known)
        if column.kind == "sensor":
            yield from stuck(rows, k, column)
