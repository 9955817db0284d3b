"""What every format of a file is made into, and the choice of its columns by name."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxreplay.errors import ConfigError, suggest
from jaxreplay.records.given import numbers

Columns = Mapping[str, Sequence[str]]  # a column → names of its elements; [column] if it has one
Observed = Literal["before", "after"]  # whether a row's observation is before or after its action


class Wanted(NamedTuple):
    """What a user asks of a file.

    Attributes:
        sensors: names of columns or of their elements; None: all that the format knows as such.
        commands: likewise.
        angles: names of sensors in rad that become their cosine and sine.
        episode: column whose value tells episodes apart; None: the format's own.
        time: column with the time in s; None: the format's own, if any.
    """

    sensors: Sequence[str] | None = None
    commands: Sequence[str] | None = None
    angles: Sequence[str] = ()
    episode: str | None = None
    time: str | None = None


class Part(NamedTuple):
    """An element of a column, and its name as a sensor or a command."""

    name: str
    column: str
    element: int


class Selection(NamedTuple):
    """The chosen elements, in order."""

    sensors: list[Part]
    commands: list[Part]
    angles: list[Part]

    def sensor_names(self) -> list[str]:
        """Return the names of sensors, two for an angle."""
        pairs = (
            (f"cos({part.name})", f"sin({part.name})") if part in self.angles else (part.name,)
            for part in self.sensors
        )
        return [name for pair in pairs for name in pair]

    def command_names(self) -> list[str]:
        """Return the names of commands."""
        return [part.name for part in self.commands]


class Episode(NamedTuple):
    """One demonstration, as its file has it.

    Attributes:
        where: file and episode, for errors.
        observations: `[T, n_s]`, or `[T + 1, n_s]`.
        actions: `[T, n_u]`.
        time: `[T]` or `[T + 1]` in s, of each observation; None if unknown.
        period: time between rows in s by the file's description; None if it has none.
    """

    where: str
    observations: np.ndarray
    actions: np.ndarray
    time: np.ndarray | None
    period: float | None


class Recording(NamedTuple):
    """Episodes of a file, what was chosen of them, and the format's order in a row."""

    selection: Selection
    episodes: list[Episode]
    observed: Observed


def select(
    wanted: Wanted,
    where: str,
    observations: Columns,
    actions: Columns,
    sensors: Sequence[str] | None,
    commands: Sequence[str] | None,
) -> Selection:
    """Return the elements that a user wants.

    Args:
        wanted: the user's wishes.
        where: the file, for errors.
        observations: columns in which a sensor's name is looked up first; the actions come second.
        actions: columns in which a command's name is looked up first.
        sensors: columns that are the sensors by default; None: they must be named.
        commands: columns that are the commands by default; None likewise.

    Raises:
        ConfigError: a name is unknown or given twice, or nothing is named without a default.
    """
    chosen = _choose(wanted.sensors, sensors, observations, actions, where, "sensor")
    angles = _choose(wanted.angles, [], observations, actions, where, "angle")
    if strange := [part.name for part in angles if part not in chosen]:
        known = [part.name for part in chosen]
        raise ConfigError(f"{where}: no sensor is named {suggest(strange[0], known)}, for an angle")
    controls = _choose(wanted.commands, commands, actions, observations, where, "command")
    return Selection(chosen, controls, angles)


def gather(
    selection: Selection,
    where: str,
    observation: Callable[[str], Any],
    action: Callable[[str], Any],
    time: Any = None,
    period: float | None = None,
) -> Episode:
    """Return an episode with the chosen elements.

    Args:
        selection: the chosen elements.
        where: file and episode, for errors.
        observation: returns a sensor's column by its name, `[T]` or `[T, k]`.
        action: likewise a command's.
        time: see :class:`Episode`.
        period: see :class:`Episode`.

    Raises:
        ValueError: a column is not of numbers, or columns differ in length.
    """
    seen = _side_by_side(selection.sensors, observation, where)
    rows = []
    for part, values in zip(selection.sensors, seen.T, strict=True):
        rows += [np.cos(values), np.sin(values)] if part in selection.angles else [values]
    time = None if time is None else numbers(time, f"{where}: time").reshape(-1)
    if time is not None and len(time) != len(seen):
        raise ValueError(f"{where}: {len(time)} times but {len(seen)} observations")
    sent = _side_by_side(selection.commands, action, where)
    return Episode(where, np.stack(rows, axis=1), sent, time, period)


def labels(column: str, width: int, names: Any = None) -> list[str]:
    """Return the names of a column's elements: those given if they fit, else `column[0]`, ….

    Args:
        column: its name.
        width: number of its elements; 0 for a column of single numbers, named as the column.
        names: names of the elements as a file lists them, if it does: a list, or lists in a dict.
    """
    if isinstance(names, Mapping):
        names = [name for group in names.values() for name in group]
    if width and isinstance(names, list) and len(set(map(str, names))) == len(names) == width:
        return [str(name) for name in names]
    return [f"{column}[{k}]" for k in range(width)] if width else [column]


def library(name: str, extra: str) -> Any:
    """Return an optional library.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        raise ConfigError(
            f".{extra} files need {name.partition('.')[0]}: pip install 'jaxreplay[{extra}]'"
        ) from None


def _choose(
    wanted: Sequence[str] | None,
    default: Sequence[str] | None,
    first: Columns,
    second: Columns,
    where: str,
    what: str,
) -> list[Part]:
    """Return the parts with the wanted names, those of the first columns before the second's."""
    table: dict[str, list[Part]] = {}
    for columns in (second, first):
        count = Counter(name for names in columns.values() for name in names)
        for column, names in columns.items():
            parts = [
                Part(name if count[name] == 1 else f"{column}.{name}", column, k)
                for k, name in enumerate(names)
            ]
            table |= {part.name: [part] for part in parts}
            table |= {f"{column}[{k}]": [part] for k, part in enumerate(parts)}
            table[column] = parts
    known = [*dict.fromkeys([*first, *(name for names in first.values() for name in names)])]
    wanted = default if wanted is None else wanted
    if wanted is None or (not wanted and what != "angle"):
        raise ConfigError(f"{where}: give its {what}s by name; its columns are {', '.join(known)}")
    chosen: list[Part] = []
    for name in wanted:
        if name not in table:
            raise ConfigError(f"{where}: no {what} is named {suggest(name, known)}")
        if twice := [part.name for part in table[name] if part in chosen]:
            raise ConfigError(f"{where}: {what} {twice[0]} is named twice; leave one out")
        chosen += table[name]
    return chosen


def _side_by_side(parts: list[Part], load: Callable[[str], Any], where: str) -> np.ndarray:
    loaded = {}
    for part in parts:
        if part.column in loaded:
            continue
        values = numbers(load(part.column), f"{where}: {part.column}")
        values = values[:, None] if values.ndim == 1 else values
        width = max(p.element for p in parts if p.column == part.column) + 1
        if values.ndim != 2 or values.shape[1] < width:
            raise ValueError(
                f"{where}: {part.column} has shape {values.shape}; a column of numbers or of "
                f"vectors is needed, with {width} elements"
            )
        loaded[part.column] = values
    lengths = {column: len(values) for column, values in loaded.items()}
    if len(set(lengths.values())) > 1:
        each = ", ".join(f"{column} has {n} rows" for column, n in lengths.items())
        raise ValueError(f"{where}: {each}; columns used together need as many rows")
    return np.stack([loaded[part.column][:, part.element] for part in parts], axis=1)
