"""Check recordings before they are replayed: summarise them, and find what is unusual in them."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from jaxreplay.recordings.findings import findings_of
from jaxreplay.recordings.findings.finding import Column, Finding, measured
from jaxreplay.recordings.findings.prediction import (
    Prediction,
    predict,
    shifted,
    unlike,
    unpredicted,
)
from jaxreplay.records import Records


class Inspection(NamedTuple):
    """A summary of N records.

    Attributes:
        lengths: `[N]` rows.
        period: s between rows; None when unknown.
        columns: n_s sensors, then n_u commands.
        findings: what is unusual.
        prediction: how well the others predict each record; None if not computed.
    """

    lengths: np.ndarray
    period: float | None
    columns: list[Column]
    findings: list[Finding]
    prediction: Prediction | None = None


def inspect(
    records: Records,
    *,
    scores: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Inspection:
    """Summarise records, and find what is unusual in them.

    Found are records that are too short, of an unusual length, in motion at their end, or copies of
    another (whole, or of its beginning); sensors and commands that never change or spike; and
    sensors that jump, are stuck, wrap as angles do, change sign together, show the time, or are
    not measured everywhere. Jumps are searched for only in three records or more. With fewer, a
    sensor counts as stuck only if it keeps a value inside its range for most of a record.

    Args:
        records: N records.
        scores: whether to filter each record with the others too, which finds records that these
            predict badly and commands that are a row early or late. Takes ten seconds to compile
            and some ten for twenty records of a minute; left out with fewer than three records.
        progress: with `scores`, called with the time steps done and their total.
    """
    rows = table_of(records)
    columns = columns_of(rows, records.sensor_names, records.command_names)
    findings = list(findings_of(rows, columns))
    prediction = predict(records, progress) if scores else None
    if prediction is not None:
        findings += [*unpredicted(prediction), *unlike(prediction), *shifted(prediction)]
    lengths = np.array([len(r) for r in rows])
    return Inspection(lengths, records.period, columns, findings, prediction)


def table_of(records: Records) -> list[np.ndarray]:
    """Return each record as an array (L_i, n_s + n_u): sensors, then commands."""
    return [np.hstack(pair) for pair in zip(*records.sequences(), strict=True)]


def columns_of(
    rows: list[np.ndarray], sensor_names: tuple[str, ...], command_names: tuple[str, ...]
) -> list[Column]:
    """Return a summary of each column of such a table."""
    named: Iterator[tuple[str, str]] = (
        (name, kind)
        for kind, names in (("sensor", sensor_names), ("command", command_names))
        for name in names
    )
    return [_column([r[:, k] for r in rows], *column) for k, column in enumerate(named)]


def _column(values: list[np.ndarray], name: str, kind: str) -> Column:
    every = np.concatenate(values)
    known = measured(every)
    missing = len(every) - len(known)
    levels = np.nan, np.nan, np.nan
    if len(known):
        levels = known.min(), float(np.median(known)), known.max()
    steps = [np.abs(np.diff(x)) for x in values]
    sizes = measured(np.concatenate(steps))
    if len(sizes) == 0:
        return Column(name, kind, *levels, np.nan, np.nan, None, np.nan, missing)
    steps = [np.nan_to_num(s, nan=-1) for s in steps]
    i = int(np.argmax([s.max(initial=-1) for s in steps]))
    at = (i, int(np.argmax(steps[i])) + 1) if sizes.any() else None
    unchanged = float(np.mean(sizes == 0))
    return Column(name, kind, *levels, float(np.median(sizes)), sizes.max(), at, unchanged, missing)
