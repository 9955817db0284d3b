"""What a user gives as demonstrations: lists of arrays or data frames, made plain arrays here.

A common mistake is answered with what to pass instead.
"""

from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

_REFUSED = {  # by the kind of a NumPy type
    "U": "it contains text",
    "S": "it contains text",
    "M": "it contains dates; convert them to seconds",
    "m": "it contains time differences; convert them to seconds: x / np.timedelta64(1, 's')",
    "c": "it contains complex numbers; pass real and imaginary parts as two columns",
    "V": "it has named fields; pass them as columns: "
    "numpy.lib.recfunctions.structured_to_unstructured(x)",
}


def one_for_each(
    given: Iterable[Any], what: str, names: Sequence[str] | None = None
) -> tuple[list[Any], Sequence[str] | None]:
    """Return what was given for each demonstration as a list, and the names of its columns.

    Data frames (pandas, polars) become arrays. Their columns are taken by name: in the order of
    `names`, or of the first data frame where that is None.

    Args:
        given: N arrays or data frames, or one array `[N, L, n]`.
        what: how an error calls them, such as `"sensors"`.
        names: names of the columns, if given by the user.

    Raises:
        ValueError: it is no list of arrays or data frames, or the names of columns disagree.
    """
    each = _as_list(given, what)
    frames = [is_frame(rows) for rows in each]
    if not any(frames):
        return each, names
    if not all(frames):
        i = frames.index(False)
        raise ValueError(
            f"record {i}: {what} has no column names, but record {frames.index(True)} is a data "
            "frame; pass all as data frames, or all as arrays (frame.to_numpy())"
        )
    order = _columns(each[0]) if names is None else [str(name) for name in names]
    source = "record 0 has" if names is None else "the names given are"
    arrays = []
    for i, frame in enumerate(each):
        found = _columns(frame)
        if sorted(found) != sorted(order) or len(set(found)) != len(found):
            raise ValueError(
                f"record {i}: {what} has the columns {', '.join(found)}; {source} "
                f"{', '.join(order)}; pick the same distinct columns in each: frame[names]"
            )
        arrays.append(_frame_rows(frame, order, f"record {i}: {what}"))
    return arrays, order


def numbers(rows: Any, where: str) -> np.ndarray:
    """Return an array as float64: bools as 0 and 1, masked and missing values as NaN.

    Args:
        rows: an array, or nested lists, of any shape.
        where: what an error starts with, such as `"record 0: sensors"`.

    Raises:
        ValueError: it is not an array of real numbers.
    """
    if _is_group(rows):
        raise ValueError(
            f"{where} is the HDF5 group {rows.name}; pass one of its datasets, group[key][:], "
            f"where key is one of: {_some(rows)}"
        )
    if isinstance(rows, Mapping):
        raise ValueError(
            f"{where} is a dict; pass its arrays side by side: "
            f"np.column_stack([d[key] for key in ({_some(rows)})])"
        )
    try:
        if isinstance(rows, list | tuple) and any(np.ma.isMaskedArray(row) for row in rows):
            rows = np.ma.stack(rows)
        array = rows if np.ma.isMaskedArray(rows) else np.asarray(rows)
        if array.dtype.kind == "O":
            return _objects(array, where)
        if array.dtype.kind not in _REFUSED:
            filled = np.ma.filled(array.astype(np.float64), np.nan)
            return np.asarray(filled, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        if str(error).startswith(where):
            raise
        raise ValueError(f"{where} is not an array of numbers: {error}") from None
    raise ValueError(f"{where} is not an array of numbers: {_REFUSED[array.dtype.kind]}")


def is_frame(rows: Any) -> bool:
    """Return whether this is a data frame of pandas or polars, without importing either."""
    return all(hasattr(rows, name) for name in ("columns", "dtypes", "to_numpy"))


def _as_list(given: Any, what: str) -> list[Any]:
    each = f"pass a list with one array (time steps, dimensions) for each demonstration as {what}"
    if is_frame(given):
        raise ValueError(
            f"{what} is one data frame, not a list; wrap it in a list: [{what}], or split it into "
            "one data frame for each demonstration"
        )
    if _is_group(given):
        raise ValueError(
            f"{what} is the HDF5 group {given.name}; {each}, such as "
            "[group[key][:] for key in group], or read the file with jr.read"
        )
    if isinstance(given, Mapping):
        raise ValueError(f"{what} is a dict; {each}, such as list({what}.values())")
    if isinstance(given, str | bytes) or hasattr(given, "__fspath__"):
        raise ValueError(f"{what} is {given!r}; {each}; jr.read reads a file")
    ndim = getattr(given, "ndim", None)
    if ndim == 2:
        raise ValueError(
            f"{what} is one array of shape {tuple(given.shape)}; wrap it in a list: [{what}], "
            "with one array for each demonstration"
        )
    objects = getattr(getattr(given, "dtype", None), "kind", None) == "O"
    if ndim is not None and ndim != 3 and not (ndim == 1 and objects):
        raise ValueError(f"{what} is an array of shape {tuple(given.shape)}; {each}")
    try:
        return list(given)
    except TypeError:
        raise ValueError(f"{what} is {given!r}; {each}") from None


def _columns(frame: Any) -> list[str]:
    return [str(name) for name in frame.columns]


def _frame_rows(frame: Any, order: list[str], where: str) -> np.ndarray:
    """Return the columns of a data frame in this order, `[L, n]`."""
    label = dict(zip(_columns(frame), frame.columns, strict=True))
    columns = [numbers(frame[label[name]].to_numpy(), f"{where}, column {name},") for name in order]
    for name, column in zip(order, columns, strict=True):
        if column.ndim != 1:
            raise ValueError(
                f"{where}, column {name}, contains arrays of shape {column.shape[1:]}; pass each "
                "of their values as its own column"
            )
    return np.stack(columns, axis=1) if columns else np.empty((len(frame), 0))


def _objects(array: np.ndarray, where: str) -> np.ndarray:
    """Return an array of Python objects as float64; None and pandas' NA become NaN."""
    values = np.ma.filled(array, None).ravel()
    missing = [value is None or type(value).__name__ == "NAType" for value in values]
    for value, gone in zip(values, missing, strict=True):
        if gone or isinstance(value, Real | np.bool_):
            continue
        if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes):
            raise ValueError(
                f"{where} is a column of arrays, not one array; stack them: np.stack(column)"
            )
        kind = "text" if isinstance(value, str) else type(value).__name__
        raise ValueError(f"{where} is not an array of numbers: it contains {kind}, {value!r}")
    plain = [np.nan if gone else float(x) for x, gone in zip(values, missing, strict=True)]
    return np.array(plain, dtype=np.float64).reshape(array.shape)


def _is_group(given: Any) -> bool:
    """Return whether this is a group of HDF5, without importing h5py."""
    return type(given).__module__.startswith("h5py") and hasattr(given, "keys")


def _some(keys: Iterable[Any]) -> str:
    """Return the first keys, as text."""
    listed = [repr(key) for key in keys]
    return ", ".join(listed[:8]) + (", …" if len(listed) > 8 else "")
