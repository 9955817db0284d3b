"""A study as the page draws it: a cell for each combination of factors, with its runs."""

from math import prod
from typing import Any

import xarray as xr

from jaxreplay.figures.table import rate, short, units
from jaxreplay.study.dataset import along, axes_of, meanings


def picture(study: xr.Dataset) -> dict[str, Any]:
    """Return the cells of a study: those of its last axis are columns, all others rows.

    Returns:
        `rows` and `columns`, their titles; `cells`, for each row and column how often it succeeded
        (`success`, 0 … 1, None without a run), its `text`, and the `outcome` of each run with its
        index in the study; and `meanings` of the outcomes.
    """
    axes = axes_of(study)
    sizes = [study.sizes[axis] for axis in axes]
    *of_rows, columns = sizes or [1]
    outcome = study.outcome.values.reshape(prod(of_rows), columns, -1)
    labels = [[_title(study, axis, k) for k in range(study.sizes[axis])] for axis in axes]
    rows = [""]
    for names in labels[:-1]:
        rows = [f"{row}, {name}".removeprefix(", ") for row in rows for name in names]
    codes, cells, index = meanings(study), [], 0
    for row in outcome:
        cells.append([])
        for runs in row:
            done = [code for code in runs if code]
            counts = {code: done.count(code) for code in codes if code in done}
            won = counts.get("S", 0)
            text = ", ".join(f"{code} {n}" for code, n in counts.items())
            cells[-1].append(
                {
                    "success": won / len(done) if done else None,
                    "text": f"{text or 'not run'}; S {rate(won, len(done))} %",
                    "first": index,
                    "outcomes": [str(code) for code in runs],
                }
            )
            index += len(runs)
    return {
        "rows": rows,
        "columns": labels[-1] if labels else [""],
        "cells": cells,
        "meanings": codes,
    }


def _title(study: xr.Dataset, axis: str, k: int) -> str:
    """Return the values of the factors at a place of an axis."""
    return ", ".join(
        f"{study[name].attrs['symbol']} {short(study[name].values[k])}{units(study, name)}"
        for name in along(study, axis)
    )
