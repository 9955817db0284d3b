"""An inspection as text."""

import numpy as np

from jaxreplay.recordings.inspect import Inspection, rows_in_words


def report(inspection: Inspection) -> str:
    """Return an inspection as text: lengths, a table of the columns, and the findings."""
    lengths, period, columns, findings = inspection
    known = "period unknown" if period is None else f"a row every {period:g} s"
    n = len(lengths)
    lines = [
        f"{n} record{'s' * (n > 1)}, {known}; {rows_in_words(lengths.sum(), period)} in all",
        "records and rows are counted from 0",
        f"shortest: record {np.argmin(lengths)}, {rows_in_words(lengths.min(), period)}; "
        f"median: {rows_in_words(float(np.median(lengths)), period)}; "
        f"longest: record {np.argmax(lengths)}, {rows_in_words(lengths.max(), period)}",
    ]
    width = max(10, *(len(column.name) for column in columns))
    for kind in ("sensor", "command"):
        lines += [
            "",
            f"{kind:<{width}}{'lowest':>13}{'median':>13}{'highest':>13}{'median step':>12}"
            f"{'largest':>10}  {'at record, row':<16}{'unchanged':>9}",
        ]
        for c in columns:
            if c.kind != kind:
                continue
            row = f"{c.name:<{width}}{c.lowest:>13.6g}{c.median:>13.6g}{c.highest:>13.6g}"
            at = f"{c.at[0]}, {c.at[1]}" if c.at else "–"
            row += f"{c.step:>12.3g}{c.largest:>10.3g}  {at:<16}{c.unchanged:>9.1%}"
            lines.append(row.replace("nan%", "   –").replace("nan", "  –"))
    found = [f"  {finding.text}" for finding in findings] or ["  nothing unusual found"]
    return "\n".join([*lines, "", "Worth a look:", *found])
