"""Is a set of recordings sane? What it holds, and what in it is worth a look before a replay.

What is far off is judged by what is usual in the same records: by medians, which a few bad
records do not move, and never by a sensor's units.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxreplay.filter import LAST_STEPS
from jaxreplay.records import Records

FEW = 3  # records; with fewer, a median over them says nothing of what is usual
# Of normal lengths one in 16 thousand is that many deviations off, though of equal ones any is:
LENGTH_DEVIATIONS, LENGTH_SHARE = 4, 0.25  # of the median, by which lengths may always differ
NORMAL = 1.4826  # standard deviations in the median absolute deviation of a normal distribution
# A sensor that sees something come into range leaps far, but in most records about as far: on the
# plane up to twice the usual. A spike is gone again, which no such leap is; it is held against
# steps that a record takes so often that no single event makes them.
JUMP = 4  # times the median over records of their largest step
SPIKE, SPIKE_ROWS = 5, 2  # times the median over records of their fifth largest step; rows it lasts
OFTEN = 5
# Sensors rest where they see nothing, and while the robot stands: on the plane twice the usual.
STUCK, STUCK_ROWS = 3, 20  # times the median over records of their longest rest; never fewer rows
STUCK_SHARE = 0.5  # of a record, where records are few
SAME = 1e-6  # of a sensor's or a command's range, which float32 resolves
NAMED = 6  # records named in a line


class Column(NamedTuple):
    """A sensor or a command over all records, in its own units.

    Attributes:
        name: as recorded.
        kind: `"sensor"` or `"command"`.
        lowest: of all rows.
        median: of all rows.
        highest: of all rows.
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
    """Something worth a look.

    Attributes:
        text: one line: what, where, and what to do.
        records: it is about these, from 0; none when it is about all.
        column: it is about this one of `Inspection.columns`; None when about whole records.
        at: record and row of the worst case, from 0, where there is one.
    """

    text: str
    records: tuple[int, ...] = ()
    column: int | None = None
    at: tuple[int, int] | None = None


class Inspection(NamedTuple):
    """What N records hold.

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
    """Summarise records, and find what in them is unusual.

    Jumps from one level to another and, but for the crudest, sensors that are stuck are found
    only from three records on; a recording held twice only where both begin at the same row.
    """
    rows = table_of(records)
    columns = [_column(rows, k, *named) for k, named in enumerate(_named(records))]
    findings = [*_short(rows), *_lengths(rows), *_copies(rows)]
    for k, column in enumerate(columns):
        findings += _still(rows, k, column)
        if column.kind == "sensor":
            findings += [*_leaps(rows, k, column), *_stuck(rows, k, column)]
    return Inspection(np.array([len(r) for r in rows]), records.period, columns, findings)


def table_of(records: Records) -> list[np.ndarray]:
    """N arrays (L_i, n_s + n_u): sensors, then commands."""
    return [np.hstack(pair) for pair in zip(*records.sequences(), strict=True)]


def report(inspection: Inspection) -> str:
    """An inspection in words and a table; records and rows count from 0."""
    lengths, period, columns, findings = inspection
    known = "period unknown" if period is None else f"a row every {period:g} s"
    n = len(lengths)
    lines = [
        f"{n} record{'s' * (n > 1)}, {known}; {_long(lengths.sum(), period)} in all",
        f"shortest: record {np.argmin(lengths)}, {_long(lengths.min(), period)}; "
        f"median: {_long(np.median(lengths), period)}; "
        f"longest: record {np.argmax(lengths)}, {_long(lengths.max(), period)}",
    ]
    width = max(10, *(len(column.name) for column in columns))
    for kind in ("sensor", "command"):
        lines += [
            "",
            f"{kind:<{width}}{'lowest':>13}{'median':>13}{'highest':>13}{'usual step':>12}"
            f"{'largest':>10}  {'at record, row':<16}{'unchanged':>9}",
        ]
        for c in columns:
            if c.kind != kind:
                continue
            row = f"{c.name:<{width}}{c.lowest:>13.6g}{c.median:>13.6g}{c.highest:>13.6g}"
            at = f"{c.at[0]}, {c.at[1]}" if c.at else "–"
            row += f"{c.step:>12.3g}{c.largest:>10.3g}  {at:<16}{c.unchanged:>9.1%}"
            lines.append(row.replace("nan%", "   –").replace("nan", "  –"))
    told = [f"  {finding.text}" for finding in findings]
    return "\n".join([*lines, "", "Worth a look:", *(told or ["  nothing unusual found"])])


def _long(rows: float, period: float | None = None) -> str:
    seconds = "" if period is None else f" ({rows * period:.4g} s)"
    return f"{rows:.12g} {'row' if rows == 1 else 'rows'}{seconds}"


def _named(records: Records) -> Iterator[tuple[str, str]]:
    for kind, names in (("sensor", records.sensor_names), ("command", records.command_names)):
        yield from ((name, kind) for name in names)


def _column(rows: list[np.ndarray], k: int, name: str, kind: str) -> Column:
    values = np.concatenate([r[:, k] for r in rows])
    held = name, kind, values.min(), float(np.median(values)), values.max()
    steps = [np.abs(np.diff(r[:, k])) for r in rows]
    sizes = np.concatenate(steps)
    if len(sizes) == 0:
        return Column(*held, np.nan, np.nan, None, np.nan)
    i = int(np.argmax([s.max(initial=-1) for s in steps]))
    at = (i, int(np.argmax(steps[i])) + 1) if sizes.any() else None
    return Column(*held, float(np.median(sizes)), sizes.max(), at, float(np.mean(sizes == 0)))


def _short(rows: list[np.ndarray]) -> Iterator[Finding]:
    short = {i: _long(len(r)) for i, r in enumerate(rows) if len(r) < LAST_STEPS}
    if short:
        yield Finding(
            f"{_listed(short)}: fewer than the {LAST_STEPS} rows by which a record's end is told "
            "(section 2.2.5), so a replay may end as it begins; leave out",
            tuple(short),
        )


def _lengths(rows: list[np.ndarray]) -> Iterator[Finding]:
    lengths = np.array([len(r) for r in rows])
    median = np.median(lengths)
    off = np.abs(lengths - median)
    limit = max(LENGTH_DEVIATIONS * NORMAL * np.median(off), LENGTH_SHARE * median)
    far = {i: _long(n) for i, n in enumerate(lengths) if off[i] > limit and n >= LAST_STEPS}
    if far:
        yield Finding(
            f"{_listed(far)}: {median:g} are usual; is all of the task in there, and nothing "
            "else? cut or leave out",
            tuple(far),
        )


def _copies(rows: list[np.ndarray]) -> Iterator[Finding]:
    """Records that are the beginning of another, or all of it."""
    span = np.ptp(np.concatenate(rows), axis=0)
    long = [i for i, r in enumerate(rows) if len(r) >= LAST_STEPS]
    copies: dict[int, dict[int, str]] = {}
    for i in sorted(long, key=lambda i: -len(rows[i])):
        n = len(rows[i])
        for j in copies:
            # The last row first: it tells most pairs apart.
            near = np.all(np.abs(rows[i][-1] - rows[j][n - 1]) <= SAME * span)
            if near and np.all(np.abs(rows[i] - rows[j][:n]) <= SAME * span):
                copies[j][i] = "" if n == len(rows[j]) else _long(n)
                break
        else:
            copies[i] = {}
    for j, again in copies.items():
        if again:
            yield Finding(
                f"{_listed(again)}: the same as record {j}, row by row; the filter would count "
                "what happened once as if it had happened again: keep one",
                tuple(sorted([*again, j])),
            )


def _still(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """A column that never changes; in a few records, or at all."""
    # A record that breaks off early lacks what would have happened later.
    whole = max(LAST_STEPS, (1 - LENGTH_SHARE) * np.median([len(r) for r in rows]))
    long = [i for i, r in enumerate(rows) if len(r) >= whole]
    still = {i: f"{rows[i][0, k]:.6g}" for i in long if np.ptp(rows[i][:, k]) == 0}
    moving = len(long) - len(still)
    if column.lowest == column.highest:
        tells = {"sensor": "it tells the filter nothing", "command": "a replay can send no other"}
        yield Finding(
            f"{column.kind} {column.name} is {column.lowest:.6g} in every row: "
            f"{tells[column.kind]}; leave it out, or see why it was not recorded",
            column=k,
        )
    elif still and len(still) <= moving / 2:
        cause = {"sensor": "dead", "command": "not recorded"}
        yield Finding(
            f"{column.kind} {column.name} never changes in {_listed(still)}, but does in {moving} "
            f"others: {cause[column.kind]}? then leave out",
            tuple(still),
            k,
        )


def _leaps(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Spikes, which are gone after a row or two; jumps, which stay."""
    moving = {i: np.diff(r[:, k]) for i, r in enumerate(rows) if len(r) >= LAST_STEPS}
    moving = {i: d for i, d in moving.items() if d.any()}
    if not moving:
        return
    often = np.median([np.sort(np.abs(d))[-OFTEN] for d in moving.values()])
    largest = np.median([np.abs(d).max() for d in moving.values()])
    spikes, jumps = {}, {}
    for i, d in moving.items():
        ahead = np.pad(d, (0, SPIKE_ROWS))[1:]
        back = np.lib.stride_tricks.sliding_window_view(ahead, SPIKE_ROWS)
        gone = np.minimum(np.abs(d), (-np.sign(d)[:, None] * back).max(axis=1))
        spiky = (gone > SPIKE * often) & (often > 0)
        # A step on which a spike begins or ends is no jump besides.
        part = np.convolve(spiky, np.ones(SPIKE_ROWS + 1))[: len(d)] > 0
        jump = (np.abs(d) > JUMP * largest) & ~part & (len(moving) >= FEW)
        for found, where in ((spikes, spiky), (jumps, jump)):
            found.update({(i, int(t) + 1): abs(d[t]) for t in np.flatnonzero(where)})
    slip = "a slip, a gap, or an angle that wraps? mend, cut there or leave out"
    for found, verb, usual, remedy in (
        (spikes, "has a spike of", often, "a glitch? smooth it out in the recording"),
        (jumps, "jumps by", largest, slip),
    ):
        if found:
            i, t = at = max(found, key=found.get)
            which = sorted({j for j, _ in found})
            others = len(found) - 1
            more = f" ({others} more; {_listed(dict.fromkeys(which, ''))})" if others else ""
            yield Finding(
                f"sensor {column.name} {verb} {found[at]:.3g} at record {i}, row {t}{more}, "
                f"{found[at] / usual:.2g} times a usual large step: {remedy}",
                tuple(which),
                k,
                at,
            )


def _stuck(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Rests in one place that are far longer than is usual."""
    rests = {i: _longest_rest(r[:, k]) for i, r in enumerate(rows) if np.ptp(r[:, k]) > 0}
    usual = np.median([n for n, _ in rests.values()]) if len(rests) >= FEW else None
    stuck = {}
    for i, (n, t) in rests.items():
        if usual is None:
            # Where a sensor's range ends it may well see nothing for most of a record.
            inside = column.lowest < rows[i][t, k] < column.highest
            limit = STUCK_SHARE * len(rows[i]) if inside else np.inf
        else:
            limit = STUCK * usual
        if n > max(STUCK_ROWS, limit):
            stuck[i] = n, t
    if stuck:
        i = max(stuck, key=stuck.get)
        n, t = stuck[i]
        others = dict.fromkeys(set(stuck) - {i}, "")
        more = f" (also in {_listed(others)})" if others else ""
        usually = "" if usual is None else f", where {usual:g} are usual"
        yield Finding(
            f"sensor {column.name} stays at {rows[i][t, k]:.6g} for {n} rows from record {i}, row "
            f"{t}{usually}{more}: stuck? cut there or leave out",
            tuple(sorted(stuck)),
            k,
            (i, t),
        )


def _longest_rest(values: np.ndarray) -> tuple[int, int]:
    """Rows of the longest run of one value, and where it begins."""
    begins = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [len(values)]])
    lengths = np.diff(begins)
    k = int(np.argmax(lengths))
    return int(lengths[k]), int(begins[k])


def _listed(notes: dict[int, str]) -> str:
    """Records by number, with what there is to say of each; not more than fit into a line."""
    named = [f"{i} ({notes[i]})" if notes[i] else str(i) for i in sorted(notes)]
    rest = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
    return f"record{'s' * (len(named) > 1)} {', '.join(named[:NAMED])}{rest}"
