"""A finding, the column that it may concern, and the words that findings share."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

FEW = 3  # records; a median over fewer says nothing of what is usual
NAMED = 6  # records that a finding lists by number; of more, it gives how many


class Column(NamedTuple):
    """A sensor or a command over all records, in its own units.

    Values that were not measured (NaN) do not count, nor do steps to and from them.

    Attributes:
        name: as recorded.
        kind: `"sensor"` or `"command"`.
        lowest: the lowest value; NaN, as the next two, when nothing was measured.
        median: the median of all values.
        highest: the highest value.
        step: median size of the change from row to row; NaN when there is no step.
        largest: the largest such change; NaN likewise.
        at: record and row that the largest change leads to, from 0; None without any change.
        unchanged: share of steps of size 0; NaN when there is no step.
        missing: number of rows in which it was not measured.
    """

    name: str
    kind: str
    lowest: float
    median: float
    highest: float
    step: float
    largest: float
    at: tuple[int, int] | None
    unchanged: float
    missing: int = 0


class Finding(NamedTuple):
    """Something unusual, to be checked.

    Attributes:
        text: one line: what, where, and what to do.
        records: indices of the records concerned, from 0; empty if all are.
        column: index into `Inspection.columns`; None if whole records are concerned.
        at: record and row of the worst case, from 0; None if there is no single one.
    """

    text: str
    records: tuple[int, ...] = ()
    column: int | None = None
    at: tuple[int, int] | None = None


def rows_in_words(rows: float, period: float | None = None) -> str:
    """Return a number of rows in words, and in seconds if the period is known."""
    seconds = "" if period is None else f" ({rows * period:.4g} s)"
    return f"{rows:.12g} {'row' if rows == 1 else 'rows'}{seconds}"


def listed(notes: dict[int, str]) -> str:
    """Return records by number, each with its note; at most `NAMED` of them."""
    named = [f"{i} ({notes[i]})" if notes[i] else str(i) for i in sorted(notes)]
    rest = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
    return f"record{'s' * (len(named) > 1)} {', '.join(named[:NAMED])}{rest}"


def others(cases: Iterable[tuple[int, int]]) -> str:
    """Return how many cases there are besides the one named, and in which records, or nothing.

    Args:
        cases: record and row of each case.
    """
    cases = set(cases)
    which = listed(dict.fromkeys(sorted({i for i, _ in cases}), ""))
    return f" ({len(cases) - 1} more; {which})" if len(cases) > 1 else ""


def measured(values: np.ndarray) -> np.ndarray:
    """Return the values that are not NaN, in one dimension."""
    return values[~np.isnan(values)]


def span(values: np.ndarray) -> float:
    """Return the range of what was measured; 0 if nothing was."""
    values = measured(values)
    return float(np.ptp(values)) if len(values) else 0.0


def spans(rows: list[np.ndarray]) -> np.ndarray:
    """Return the range of each column over all records."""
    return np.array([span(values) for values in np.concatenate(rows).T])
