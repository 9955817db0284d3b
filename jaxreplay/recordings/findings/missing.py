"""A finding on values that were not measured."""

from collections.abc import Iterator

import numpy as np

from jaxreplay.recordings.findings.finding import Column, Finding, listed


def missing(rows: list[np.ndarray], k: int, column: Column) -> Iterator[Finding]:
    """Count the rows of a column that are NaN."""
    lacking = {i: int(np.isnan(r[:, k]).sum()) for i, r in enumerate(rows)}
    lacking = {i: n for i, n in lacking.items() if n}
    if not lacking:
        return
    total, every = sum(lacking.values()), sum(len(r) for r in rows)
    if total == every:
        where = f"in any of {every} rows: leave it out"
    else:
        which = listed({i: str(n) for i, n in lacking.items()})
        where = (
            f"in {total} of {every} rows ({total / every:.1%}; {which}): straight lines take "
            "its place there; was it out of sight, or did the recording fail?"
        )
    yield Finding(f"{column.kind} {column.name} is not measured {where}", tuple(lacking), k)
