"""An inspection as text."""

import numpy as np

from jaxreplay.recordings.findings.finding import Column, rows_in_words
from jaxreplay.recordings.findings.prediction import Prediction
from jaxreplay.recordings.inspect import Inspection


def report(inspection: Inspection) -> str:
    """Return an inspection as text: lengths, tables of columns and of scores, and the findings."""
    lengths, period, columns, findings, prediction = inspection
    known = "period unknown" if period is None else f"a row every {period:g} s"
    n = len(lengths)
    lines = [
        f"{n} record{'s' * (n > 1)}, {known}; {rows_in_words(lengths.sum(), period)} in all",
        "records and rows are counted from 0",
        f"shortest: record {np.argmin(lengths)}, {rows_in_words(lengths.min(), period)}; "
        f"median: {rows_in_words(float(np.median(lengths)), period)}; "
        f"longest: record {np.argmax(lengths)}, {rows_in_words(lengths.max(), period)}",
        *_columns(columns),
    ]
    if prediction is not None:
        lines += _scores(prediction)
    found = [f"  {finding.text}" for finding in findings] or ["  nothing unusual found"]
    return "\n".join([*lines, "", "Worth a look:", *found])


def _columns(columns: list[Column]) -> list[str]:
    width = max(10, *(len(column.name) for column in columns))
    lines = []
    for kind in ("sensor", "command"):
        chosen = [c for c in columns if c.kind == kind]
        lacking = any(c.missing for c in chosen)
        lines += [
            "",
            f"{kind:<{width}}{'lowest':>13}{'median':>13}{'highest':>13}{'median step':>12}"
            f"{'largest':>10}  {'at record, row':<16}{'unchanged':>9}"
            + f"{'not measured':>14}"
            * lacking,
        ]
        for c in chosen:
            row = f"{c.name:<{width}}{c.lowest:>13.6g}{c.median:>13.6g}{c.highest:>13.6g}"
            at = f"{c.at[0]}, {c.at[1]}" if c.at else "–"
            row += f"{c.step:>12.3g}{c.largest:>10.3g}  {at:<16}{c.unchanged:>9.1%}"
            row += f"{c.missing:>14}" * lacking
            lines.append(row.replace("nan%", "   –").replace("nan", "  –"))
    return lines


def _scores(prediction: Prediction) -> list[str]:
    scores, shifted = prediction
    lines = [
        "",
        "each record filtered with the others: command error as a share of the commands' range, "
        "log evidence per row (θ_I = 0.1, θ_τ = 0.05, σ = a tenth of each sensor's usual range)",
        f"{'record':<10}{'rows':>7}{'command error':>15}{'log evidence':>14}",
    ]
    for i, (rows, error, evidence) in enumerate(
        zip(scores.steps, scores.command_error_each[0], scores.log_evidence_each[0], strict=True)
    ):
        lines.append(f"{i:<10}{rows:>7}{error:>15.1%}{evidence:>14.2f}")
    all_rows, all_errors = scores.steps.sum(), scores.command_error[0]
    lines.append(f"{'all':<10}{all_rows:>7}{all_errors:>15.1%}{scores.log_evidence[0]:>14.2f}")
    lines.append(
        f"command error with commands one row earlier: {shifted[-1]:.1%}, as they are: "
        f"{shifted[0]:.1%}, one row later: {shifted[1]:.1%}"
    )
    return lines
