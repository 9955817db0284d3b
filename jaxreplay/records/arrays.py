"""Arrays that a user gives, checked, and brought into the form of :class:`Records`."""

from collections.abc import Sequence
from numbers import Real
from typing import Any, Literal

import jax
import numpy as np

from jaxreplay.records.given import numbers

# A sensor gets an offset where its largest |value| exceeds this many times its spread: without
# one, rounding to the working precision would cost its differences three bits or more.
_FAR = 8


def as_rows(rows: Any, name: str, i: int) -> np.ndarray:
    """Return one sequence as a float64 array `[L_i, n]`, finite in the working precision."""
    given = numbers(rows, f"record {i}: {name}")
    if given.ndim != 2 or 0 in given.shape:
        raise ValueError(
            f"record {i}: {name} must have shape (time steps, dimensions), both at least 1; "
            f"got {given.shape}"
        )
    rounded = cast(given)
    # A sensor's NaN is a sample that was not measured.
    good = np.isfinite(rounded) | (np.isnan(rounded) & (name in ("sensors", "observations")))
    if not good.all():
        t, k = np.argwhere(~good)[0]
        raise ValueError(
            f"record {i}: {name}[{t}, {k}] is {given[t, k]}, not a finite {rounded.dtype}; "
            "cut or fill such rows before building records"
        )
    return given


def both(
    sensors: Sequence[Any], commands: Sequence[Any]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return N arrays `[L_i, n_s]` of sensors and N arrays `[L_i, n_u]` of commands, checked."""
    sensors = [as_rows(s, "sensors", i) for i, s in enumerate(sensors)]
    commands = [as_rows(c, "commands", i) for i, c in enumerate(commands)]
    if not sensors:
        raise ValueError("records need at least one demonstration; got none")
    if len(sensors) != len(commands):
        raise ValueError(
            f"{len(sensors)} sensor sequences but {len(commands)} command sequences; "
            "give one of each for every demonstration"
        )
    for i, (s, c) in enumerate(zip(sensors, commands, strict=True)):
        if len(s) != len(c):
            raise ValueError(
                f"record {i}: {len(s)} sensor rows but {len(c)} command rows; row t is a "
                "command and the observation made after it (Records.from_steps takes "
                "one observation more than commands)"
            )
        for name, rows, first in (("sensors", s, sensors[0]), ("commands", c, commands[0])):
            if rows.shape[1] != first.shape[1]:
                raise ValueError(
                    f"record {i}: {name} has {rows.shape[1]} columns, record 0 has "
                    f"{first.shape[1]}; all records must have the same {name}"
                )
    return sensors, commands


def check_period(period: Any) -> None:
    """Check that a period is a positive number of seconds, or None."""
    if period is not None and not (isinstance(period, Real) and 0 < float(period) < np.inf):
        raise ValueError(f"period must be a positive number of seconds; got {period!r}")


def one_row_later(
    observations: Sequence[Any], actions: Sequence[Any]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the rows of records: each action with the observation that follows it.

    Args:
        observations: N arrays, the i-th `[T_i + 1, n_s]` or `[T_i, n_s]`.
        actions: N arrays, the i-th `[T_i, n_u]`.

    Raises:
        ValueError: lengths differ otherwise, or an episode leaves no row.
    """
    if len(observations) != len(actions):
        raise ValueError(
            f"{len(observations)} episodes of observations but {len(actions)} of actions; give "
            "one of each for every episode"
        )
    sensors, commands = [], []
    for i, (given, sent) in enumerate(zip(observations, actions, strict=True)):
        seen, done = as_rows(given, "observations", i), as_rows(sent, "actions", i)
        if len(seen) - len(done) not in (0, 1):
            raise ValueError(
                f"record {i}: {len(seen)} observations but {len(done)} actions; give one "
                "observation more than actions, or as many of both with each observation before "
                "its action"
            )
        if len(seen) < 2:
            raise ValueError(
                f"record {i}: 1 observation and 1 action leave no row, as a row is an action and "
                "the observation after it; at least 2 observations are needed"
            )
        sensors.append(seen[1:])
        commands.append(done[: len(seen) - 1])
    return sensors, commands


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
