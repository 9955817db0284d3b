"""Check recordings before they are replayed: summarise them, and find what is unusual in them.

Unusual is what lies far from the median over the same records: a few bad records hardly move a
median, and no limit depends on a sensor's unit.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxreplay.filter.steps import LAST_STEPS
from jaxreplay.records import Records

FEW = 3  # records; a median over fewer says nothing of what is usual
# A length is unusual if it is off the median by more than 4 standard deviations, as one in 16,000
# normally distributed lengths is, and by more than a quarter of the median: among records of almost
# equal lengths the standard deviation is near 0, so any other length would be many standard
# deviations away.
LENGTH_DEVIATIONS, LENGTH_SHARE = 4, 0.25
NORMAL = 1.4826  # a normal distribution's standard deviation in median absolute deviations
# A jump is a step of more than 4 times the median over records of their largest step. A sensor
# steps far when something comes into its range: on the plane the camera by up to 2.1 times that
# median, the proximeters by up to 1.2 (20 demonstrations with each of the seeds 0 to 5).
JUMP = 4
# A spike is a step that is taken back within 2 rows, and more than 5 times the median over records
# of their fifth-largest step (the fifth largest, because one event in a record makes fewer than
# five large steps). Nothing that comes into range leaves it so soon: on the plane the largest step
# taken back is 1.7 times that median.
SPIKE, SPIKE_ROWS, OFTEN = 5, 2, 5
# A sensor is stuck if it keeps one value for more than 3 times the median over records of their
# longest rest, and for more than 20 rows. A sensor rests while it sees nothing, and while the robot
# stands still: on the plane the camera for up to 2.1 times that median, the proximeters for 1.4.
STUCK, STUCK_ROWS = 3, 20
STUCK_SHARE = 0.5  # of a record: the limit instead of that median where records are few
SAME = 1e-6  # of a column's range: values that differ by less are equal up to float32's rounding
NAMED = 6  # records that a finding lists by number; of more, it gives how many


class Column(NamedTuple):
    """A sensor or a command over all records, in its own units.

    Attributes:
        name: as recorded.
        kind: `"sensor"` or `"command"`.
        lowest: the lowest value.
        median: the median of all values.
        highest: the highest value.
        step: median size of the change from row to row; NaN when no record has two rows.
        largest: the largest such change; NaN likewise.
        at: record and row that the largest change leads to, from 0; None without any change.
        unchanged: share of rows that equal the row before; NaN when no record has two rows.
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


class Inspection(NamedTuple):
    """A summary of N records.

    Attributes:
        lengths: `[N]` rows.
        period: s between rows; None when unknown.
        columns: n_s sensors, then n_u commands.
        findings: what is unusual.
    """

    lengths: np.ndarray
    period: float | None
    columns: list[Column]
    findings: list[Finding]


def inspect(records: Records) -> Inspection:
    """Summarise records, and find what is unusual in them.

    Found are records that are too short, of an unusual length, or copies of another (whole, or of
    its beginning); sensors and commands that never change; and sensors that spike, jump or are
    stuck. Jumps are searched for only in three records or more. With fewer, a sensor counts as
    stuck only if it keeps a value inside its range for most of a record.
    """
    rows = table_of(records)
    columns = [_column(rows, k, *column) for k, column in enumerate(_names(records))]
    findings = [*_short(rows), *_lengths(rows), *_copies(rows)]
    for k, column in enumerate(columns):
        findings += _still(rows, k, column)
        if column.kind == "sensor":
            findings += [*_leaps(rows, k, column), *_stuck(rows, k, column)]
    return Inspection(np.array([len(r) for r in rows]), records.period, columns, findings)


def table_of(records: Records) -> list[np.ndarray]:
    """Return each record as an array (L_i, n_s + n_u): sensors, then commands."""
    return [np.hstack(pair) for pair in zip(*records.sequences(), strict=True)]


def rows_in_words(rows: float, period: float | None = None) -> str:
    """Return a number of rows in words, and in seconds if the period is known."""
    seconds = "" if period is None else f" ({rows * period:.4g} s)"
    return f"{rows:.12g} {'row' if rows == 1 else 'rows'}{seconds}"


def _names(records: Records) -> Iterator[tuple[str, str]]:
    """Yield the name and the kind of each column."""
    for kind, names in (("sensor", records.sensor_names), ("command", records.command_names)):
        yield from ((name, kind) for name in names)


def _column(rows: list[np.ndarray], k: int, name: str, kind: str) -> Column:
    values = np.concatenate([r[:, k] for r in rows])
    levels = values.min(), float(np.median(values)), values.max()
    steps = [np.abs(np.diff(r[:, k])) for r in rows]
    sizes = np.concatenate(steps)
    if len(sizes) == 0:
        return Column(name, kind, *levels, np.nan, np.nan, None, np.nan)
    i = int(np.argmax([s.max(initial=-1) for s in steps]))
    at = (i, int(np.argmax(steps[i])) + 1) if sizes.any() else None
    unchanged = float(np.mean(sizes == 0))
    return Column(name, kind, *levels, float(np.median(sizes)), sizes.max(), at, unchanged)


def _short(rows: list[np.ndarray]) -> Iterator[Finding]:
    """Find records shorter than the last 10 rows that § 2.2.5 tests."""
    short = {i: rows_in_words(len(r)) for i, r in enumerate(rows) if len(r) < LAST_STEPS}
    if short:
        yield Finding(
            f"{_listed(short)}: fewer than the {LAST_STEPS} rows that count as a record's end "
            "(section 2.2.5), so a replay may end as it begins; leave out",
            tuple(short),
        )


def _lengths(rows: list[np.ndarray]) -> Iterator[Finding]:
    """Find records of an unusual length."""
    lengths = np.array([len(r) for r in rows])
    median = np.median(lengths)
    off = np.abs(lengths - median)
    limit = max(LENGTH_DEVIATIONS * NORMAL * np.median(off), LENGTH_SHARE * median)
    far = {i: rows_in_words(n) for i, n in enumerate(lengths) if off[i] > limit and n >= LAST_STEPS}
    if far:
        yield Finding(
            f"{_listed(far)}: the median length is {median:g} rows; is the whole task recorded, "
            "and nothing else? cut or leave out",
            tuple(far),
        )


def _copies(rows: list[np.ndarray]) -> Iterator[Finding]:
    """Find records that are the same as another, or as its beginning."""
    span = np.ptp(np.concatenate(rows), axis=0)
    long = [i for i, r in enumerate(rows) if len(r) >= LAST_STEPS]
    copies: dict[int, dict[int, str]] = {}  # of each record, its copies and what they lack
    for i in sorted(long, key=lambda i: -len(rows[i])):
        n = len(rows[i])
        for j in copies:
            # The last row is compared first: one row tells most pairs apart, a whole record is
            # hundreds of them.
            near = np.all(np.abs(rows[i][-1] - rows[j][n - 1]) <= SAME * span)
            if near and np.all(np.abs(rows[i] - rows[j][:n]) <= SAME * span):
                copies[j][i] = "" if n == len(rows[j]) else rows_in_words(n)
                break
        else:
            copies[i] = {}
    for j, again in copies.items():
        if again:
            yield Finding(
                f"{_listed(again)}: the same as record {j}, row by row; the filter would count "
                "one demonstration as several: keep one",
                tuple(sorted([*again, j])),
            )


def _still(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Find a column that never changes, in all records or in a few."""
    # Records that are much shorter than the others are not counted: what changes the column may
    # come only after they break off.
    whole = max(LAST_STEPS, (1 - LENGTH_SHARE) * np.median([len(r) for r in rows]))
    long = [i for i, r in enumerate(rows) if len(r) >= whole]
    still = {i: f"{rows[i][0, k]:.6g}" for i in long if np.ptp(rows[i][:, k]) == 0}
    moving = len(long) - len(still)
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
    elif still and len(still) <= moving / 2:
        cause = {"sensor": "is the sensor dead", "command": "was the command not recorded"}
        yield Finding(
            f"{column.kind} {column.name} never changes in {_listed(still)}, but does in {moving} "
            f"others: {cause[column.kind]}? then leave these records out",
            tuple(still),
            k,
        )


def _leaps(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Find spikes, which are gone after a row or two, and jumps, which stay."""
    moving = {i: np.diff(r[:, k]) for i, r in enumerate(rows) if len(r) >= LAST_STEPS}
    moving = {i: d for i, d in moving.items() if d.any()}
    if not moving:
        return
    often = np.median([np.sort(np.abs(d))[-OFTEN] for d in moving.values()])
    largest = np.median([np.abs(d).max() for d in moving.values()])
    spikes: dict[tuple[int, int], float] = {}  # size by record and row
    jumps: dict[tuple[int, int], float] = {}
    for i, d in moving.items():
        ahead = np.pad(d, (0, SPIKE_ROWS))[1:]
        back = np.lib.stride_tricks.sliding_window_view(ahead, SPIKE_ROWS)
        taken_back = np.minimum(np.abs(d), (-np.sign(d)[:, None] * back).max(axis=1))
        spiky = (taken_back > SPIKE * often) & (often > 0)
        # The steps that begin and end a spike are reported as the spike, not as jumps too.
        part = np.convolve(spiky, np.ones(SPIKE_ROWS + 1))[: len(d)] > 0
        jump = (np.abs(d) > JUMP * largest) & ~part & (len(moving) >= FEW)
        for found, where in ((spikes, spiky), (jumps, jump)):
            found.update({(i, int(t) + 1): abs(d[t]) for t in np.flatnonzero(where)})
    jumped = (
        "an error, a gap in the recording, or an angle that wraps? correct it, cut there, or leave "
        "the record out"
    )
    for found, verb, usual, rank, remedy in (
        (spikes, "has a spike of", often, "fifth-largest", "a glitch? smooth it in the recording"),
        (jumps, "jumps by", largest, "largest", jumped),
    ):
        if found:
            i, t = at = max(found, key=found.__getitem__)
            which = sorted({j for j, _ in found})
            others = len(found) - 1
            more = f" ({others} more; {_listed(dict.fromkeys(which, ''))})" if others else ""
            yield Finding(
                f"sensor {column.name} {verb} {found[at]:.3g} at record {i}, row {t}{more}, "
                f"{found[at] / usual:.2g} times the median record's {rank} step: {remedy}",
                tuple(which),
                k,
                at,
            )


def _stuck(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Find rests at one value that are far longer than usual."""
    rests = {i: _longest_rest(r[:, k]) for i, r in enumerate(rows) if np.ptp(r[:, k]) > 0}
    usual = np.median([n for n, _ in rests.values()]) if len(rests) >= FEW else None
    stuck: dict[int, tuple[int, int]] = {}  # rows and the first of them, by record
    for i, (n, t) in rests.items():
        if usual is None:
            # A rest at the end of a sensor's range is no sign: the sensor may see nothing for
            # most of a record.
            inside = column.lowest < rows[i][t, k] < column.highest
            limit = STUCK_SHARE * len(rows[i]) if inside else np.inf
        else:
            limit = STUCK * usual
        if n > max(STUCK_ROWS, limit):
            stuck[i] = n, t
    if stuck:
        i = max(stuck, key=stuck.__getitem__)
        n, t = stuck[i]
        others = dict.fromkeys(set(stuck) - {i}, "")
        more = f" (also in {_listed(others)})" if others else ""
        usually = (
            ""
            if usual is None
            else f"; other records keep one value for {usual:g} rows at most (median)"
        )
        yield Finding(
            f"sensor {column.name} stays at {rows[i][t, k]:.6g} for {n} rows from record {i}, row "
            f"{t}{more}{usually}: stuck? cut there or leave out",
            tuple(sorted(stuck)),
            k,
            (i, t),
        )


def _longest_rest(values: np.ndarray) -> tuple[int, int]:
    """Return the number of rows of the longest run of one value, and the first of them."""
    begins = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [len(values)]])
    lengths = np.diff(begins)
    k = int(np.argmax(lengths))
    return int(lengths[k]), int(begins[k])


def _listed(notes: dict[int, str]) -> str:
    """Return records by number, each with its note; at most `NAMED` of them."""
    named = [f"{i} ({notes[i]})" if notes[i] else str(i) for i in sorted(notes)]
    rest = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
    return f"record{'s' * (len(named) > 1)} {', '.join(named[:NAMED])}{rest}"
