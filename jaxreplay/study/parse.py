"""Values from a study's file, checked and converted.

A reader takes a value and its key, and returns the converted value. For a wrong value it raises a
ValueError that names the key and the allowed values. The functions here return readers, or are
readers.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from jaxreplay.errors import suggest
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import CUBE_X, CUBE_Y

Reader = Callable[[Any, str], Any]


def probability(high: float) -> Reader:
    """Return a reader of a probability that single precision tells from 0, if it is not 0."""
    smallest = float(np.finfo(np.float32).tiny)

    def read(given: Any, key: str) -> float:
        value = number(0, high)(given, key)
        if 0 < value < smallest:
            raise ValueError(f"{key} must be 0 or at least {smallest:.2g}; got {value:g}")
        return value

    return read


def number(low: float, high: float) -> Reader:
    """Return a reader of a number within bounds."""

    def read(given: Any, key: str) -> float:
        if isinstance(given, bool) or not isinstance(given, int | float):
            raise ValueError(f"{key} must be a number; got {given!r}")
        if not low <= given <= high:
            raise ValueError(f"{key} must be in [{low:g}, {high:g}]; got {_short(given)}")
        return float(given)

    return read


def whole(low: int, high: int) -> Reader:
    """Return a reader of a whole number within bounds."""

    def read(given: Any, key: str) -> int:
        if isinstance(given, bool) or not isinstance(given, int) or not low <= given <= high:
            raise ValueError(
                f"{key} must be a whole number from {low} to {high}; got {_short(given)}"
            )
        return given

    return read


def one_of(*allowed: str | bool) -> Reader:
    """Return a reader of one of some words, or of true and false."""
    listed = ", ".join(repr(a) if isinstance(a, str) else str(a).lower() for a in allowed)

    def read(given: Any, key: str) -> str | bool:
        if type(given) is not type(allowed[0]) or given not in allowed:
            raise ValueError(f"{key} must be one of {listed}; got {given!r}")
        return given

    return read


def values(given: Any, key: str, read: Reader) -> list:
    """Read a list, or the values of linspace or logspace.

    `{linspace = [first, last, how many]}` are evenly spaced; `{logspace = [first, last, how many]}`
    are powers of 10 with evenly spaced exponents.
    """
    if isinstance(given, dict):
        given = _spaced(given, key)
    elif not isinstance(given, list) or not given:
        hint = "" if isinstance(given, list) else f"; write [{given!r}]"
        raise ValueError(f"{key} must be a list of at least one value; got {given!r}{hint}")
    return [read(value, f"{key}[{i}]") for i, value in enumerate(given)]


def groups(given: Any, key: str, axes: dict[str, tuple]) -> tuple[tuple[str, ...], ...]:
    """Read the groups of axes that move together (`zip`)."""
    if not isinstance(given, list) or not all(isinstance(g, list) and len(g) > 1 for g in given):
        raise ValueError(
            f'{key} must list groups of axes, such as [["motor_unit", "battery"]]; got {given!r}'
        )
    names = [name for group in given for name in group]
    for name in names:
        if not isinstance(name, str) or name not in axes:
            raise ValueError(f"{key} names {name!r}, which is no axis here ({', '.join(axes)})")
    distinct(names, key)
    for group in given:
        lengths = [len(axes[name]) for name in group]
        if len(set(lengths)) > 1:
            raise ValueError(
                f"{key}: {', '.join(group)} have {lengths} values; give the same number of each"
            )
    return tuple(map(tuple, given))


def positions(given: Any, key: str) -> tuple[tuple[float, float], ...]:
    """Read the cube's positions: a list of [x, y], or lists x and y to be combined in full."""
    x, y = number(*CUBE_X), number(*CUBE_Y)
    if isinstance(given, dict):
        known(given, ("x", "y"), f"{key}.")
        if len(given) != 2:
            raise ValueError(f"{key} needs x and y, or a list of [x, y]; got {given!r}")
        xs, ys = (values(given[k], f"{key}.{k}", read) for k, read in (("x", x), ("y", y)))
        return distinct(list(product(xs, ys)), key)
    if not isinstance(given, list) or not given:
        raise ValueError(f"{key} must be a list of [x, y] in m; got {given!r}")
    pairs = []
    for i, pair in enumerate(given):
        if not isinstance(pair, list) or len(pair) != 2:
            raise ValueError(f"{key}[{i}] must be [x, y] in m; got {pair!r}")
        pairs.append((x(pair[0], f"{key}[{i}][0]"), y(pair[1], f"{key}[{i}][1]")))
    return distinct(pairs, key)


def optional(read: Reader) -> Reader:
    """Return a reader that also takes None."""

    def read_or_none(given: Any, key: str) -> Any:
        return None if given is None else read(given, key)

    return read_or_none


def environment(given: Any, key: str) -> str | dict[str, Any] | None:
    """Read a Gymnasium environment: its id, or a table of its id and its arguments."""
    name = given.get("id") if isinstance(given, dict) else given
    if given is not None and not (isinstance(name, str) and name):
        raise ValueError(
            f'{key} must be an id of Gymnasium, such as "MountainCarContinuous-v0" or '
            f'"module:NAME", or a table with id and the arguments of the environment; got {given!r}'
        )
    return given


def plane(given: Any, key: str) -> PlaneParams:
    """Read the constants of the plane: a table of those that differ from the defaults."""
    if not isinstance(given, dict):
        raise ValueError(f"{key} must be a table, [{key}], or PlaneParams; got {given!r}")
    defaults = plain(PlaneParams())
    for name in SETTINGS:
        if given.get(name, defaults[name]) != defaults[name]:
            raise ValueError(f"{key}.{name} is a factor: give it as {name} or axis.{name}")
    constants = tuple(name for name in defaults if name not in SETTINGS)
    known({name: 0 for name in given if name not in SETTINGS}, constants, f"{key}.")
    for name, value in given.items():
        listed = isinstance(defaults[name], list)
        numbers = value if listed and isinstance(value, list) else [value]
        if listed != isinstance(value, list) or not all(_is_number(v) for v in numbers):
            what = f"a list of {len(defaults[name])} numbers" if listed else "a number"
            raise ValueError(f"{key}.{name} must be {what}; got {_short(value)}")
    values: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in given.items()}
    try:
        return PlaneParams(**values)
    except ValueError as error:
        raise ValueError(f"{key}.{error}") from None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float)


def plain(value: Any) -> Any:
    """Return a value from Python as a TOML file gives it: tuples and arrays become lists."""
    if isinstance(value, PlaneParams):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {name: plain(v) for name, v in value.items()}
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return [plain(v) for v in value] if isinstance(value, list | tuple) else value


def known(given: dict, allowed: tuple[str, ...], prefix: str) -> None:
    """Check that a table has no unknown key.

    Raises:
        ValueError: it has one; the message suggests a known key.
    """
    for key in given:
        if key not in allowed:
            names = [f"{prefix}{name}" for name in allowed]
            raise ValueError(f"unknown key {suggest(prefix + key, names)}")


def distinct(given: list, key: str) -> tuple:
    """Return the values, if none occurs twice.

    Raises:
        ValueError: one does.
    """
    if len(set(given)) != len(given):
        twice = next(value for value in given if given.count(value) > 1)
        raise ValueError(f"{key} contains a value twice: {twice}")
    return tuple(given)


def _spaced(given: dict, key: str) -> list[float]:
    known(given, ("linspace", "logspace"), f"{key}.")
    if len(given) != 1:
        raise ValueError(f"{key} needs a list, or one of linspace and logspace; got {given!r}")
    ((way, span),) = given.items()
    what = "exponent of 10" if way == "logspace" else "value"
    if not isinstance(span, list) or len(span) != 3:
        raise ValueError(f"{key}.{way} must be [first {what}, last {what}, how many]; got {span!r}")
    first, last = (number(-300, 300)(v, f"{key}.{way}[{i}]") for i, v in enumerate(span[:2]))
    count = whole(1, 10_000)(span[2], f"{key}.{way}[2]")
    # Rounded to 12 digits, so that 0.1 compares equal to linspace's 0.1.
    spaced = [float(f"{value:.12g}") for value in np.linspace(first, last, count)]
    return [float(f"{10.0**v:.12g}") for v in spaced] if way == "logspace" else spaced


def _short(given: Any) -> str:
    return repr(given) if len(repr(given)) <= 40 else repr(given)[:40] + "…"
