"""Arrays that a user gives, checked, and brought into the form of :class:`Records`."""

from collections.abc import Sequence
from typing import Literal

import jax
import numpy as np

# A sensor gets an offset where its largest |value| exceeds this many times its spread: without
# one, rounding to the working precision would cost its differences three bits or more.
_FAR = 8


def as_rows(rows: np.ndarray, name: str, i: int) -> np.ndarray:
    """Return one sequence as a float64 array `[L_i, n]`, finite in the working precision."""
    try:
        given = np.asarray(rows, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"record {i}: {name} is not an array of numbers: {error}") from None
    if given.ndim != 2 or 0 in given.shape:
        raise ValueError(
            f"record {i}: {name} must have shape (time steps, dimensions), both at least 1; "
            f"got {given.shape}"
        )
    rounded = cast(given)
    if not np.isfinite(rounded).all():
        t, k = np.argwhere(~np.isfinite(rounded))[0]
        raise ValueError(
            f"record {i}: {name}[{t}, {k}] is {given[t, k]}, not a finite {rounded.dtype}; "
            "cut or fill such rows before building records"
        )
    return given


def cast(values: np.ndarray) -> np.ndarray:
    """Return values in the working precision; those too large for it become infinite."""
    with np.errstate(over="ignore"):
        return values.astype(jax.dtypes.canonicalize_dtype(np.float64))


def offset_of(values: np.ndarray) -> np.ndarray:
    """Return the offset of each column of values `[T, n]`: its middle, or 0; see :class:`Records`.

    It is a float32 number: subtracting it rounds no float32 number within a factor of 2 of it.
    """
    low, high = values.min(axis=0), values.max(axis=0)
    middle = (low / 2 + high / 2).astype(np.float32).astype(np.float64)
    return np.where(np.maximum(np.abs(low), np.abs(high)) > _FAR * (high - low), middle, 0.0)


def extend(rows: np.ndarray, length: int, mode: Literal["edge", "constant"]) -> np.ndarray:
    """Return rows `[T, n]` padded to a length: with the last of them, or with zeros."""
    return np.pad(rows, ((0, length - len(rows)), (0, 0)), mode=mode)


def names(given: Sequence[str] | None, n: int, letter: str, what: str) -> tuple[str, ...]:
    """Return n distinct names: those given, or the letter numbered from 0."""
    if given is None:
        return tuple(f"{letter}{k}" for k in range(n))
    strings = tuple(str(name) for name in given)
    if len(strings) != n or len(set(strings)) != n:
        raise ValueError(f"{n} distinct {what} names are needed; got {list(strings)}")
    return strings
