"""Samples that were not measured (NaN): straight lines take their place."""

import numpy as np


def filled(rows: np.ndarray, i: int, names: tuple[str, ...]) -> np.ndarray:
    """Return rows `[L, n_s]` with straight lines between measured samples in the place of NaN.

    Before the first and after the last measured sample of a sensor its value is that of this one.
    So equation 2 sees the segment between the measured samples beside a gap, cut into as many parts
    as the gap has rows.

    Args:
        rows: the record's observations.
        i: the record's number, for the message.
        names: of the sensors.

    Raises:
        ValueError: a sensor has no measured sample.
    """
    measured = ~np.isnan(rows)
    if measured.all():
        return rows
    nowhere = np.flatnonzero(~measured.any(axis=0))
    if len(nowhere):
        raise ValueError(
            f"record {i}: {names[nowhere[0]]} is NaN in all {len(rows)} rows; leave out the sensor "
            "or the record"
        )
    at = np.arange(len(rows))
    columns = [
        np.interp(at, at[there], values[there])
        for values, there in zip(rows.T, measured.T, strict=True)
    ]
    return np.column_stack(columns)
