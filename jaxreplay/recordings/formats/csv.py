"""CSV: a line of names, then a line of numbers for each row."""

import csv
from functools import partial
from pathlib import Path

import numpy as np

from jaxreplay.errors import ConfigError, suggest
from jaxreplay.recordings.formats.recording import Recording, Wanted, gather, select

_BOOLS = {"true": 1.0, "false": 0.0}


def read_csv(path: Path, wanted: Wanted) -> Recording:
    """Return the episodes in a file: all of it, or one for each value of the column `episode`.

    By default, a row's observation is made after its command. An empty cell is NaN.

    Raises:
        ConfigError: a name is unknown, sensors or commands are not named, or the file is no CSV.
    """
    header, numbers_of, lines = _table(path)
    for name in (wanted.episode, wanted.time):
        if name is not None and name not in header:
            raise ConfigError(f"{path}: no column is named {suggest(name, header)}")
    columns = {name: [name] for name in header}
    selection = select(wanted, str(path), columns, columns, None, None)
    if wanted.episode is None:
        episodes = {str(path): np.arange(len(lines))}
    else:
        k = header.index(wanted.episode)
        groups: dict[str, list[int]] = {}
        for row, line in enumerate(lines):
            groups.setdefault(line[k].strip(), []).append(row)
        episodes = {f"{path}, episode {name}": np.array(g) for name, g in groups.items()}

    values: dict[str, np.ndarray] = {}

    def column(name: str) -> np.ndarray:
        if name not in values:
            k = header.index(name)
            cells = zip(numbers_of, lines, strict=True)
            values[name] = np.array([_number(line[k], path, n, name) for n, line in cells])
        return values[name]

    def sent(name: str, rows: np.ndarray) -> np.ndarray:
        empty = np.flatnonzero(np.isnan(column(name)[rows]))
        if len(empty):
            raise ConfigError(
                f"{path}, line {numbers_of[rows[empty[0]]]}: command {name} is empty; fill it in, "
                "or leave the row out"
            )
        return column(name)[rows]

    found = []
    for where, rows in episodes.items():
        time = None if wanted.time is None else column(wanted.time)[rows]
        load = lambda name, rows=rows: column(name)[rows]  # noqa: E731
        found.append(gather(selection, where, load, partial(sent, rows=rows), time))
    return Recording(selection, found, "after")


def _table(path: Path) -> tuple[list[str], list[int], list[list[str]]]:
    """Return the names, and each row's number of its line, and its cells."""
    numbers, lines = [], []
    try:
        with open(path, newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = [name.strip() for name in next(reader, [])]
            for line in reader:
                if not line:
                    continue
                if len(header) == 1 and header[0].count(";") > 0:
                    raise ConfigError(f"{path}: its cells are separated by ';'; write commas")
                if len(line) != len(header):
                    raise ConfigError(
                        f"{path}, line {reader.line_num}: {len(line)} cells, but line 1 names "
                        f"{len(header)} columns"
                    )
                numbers.append(reader.line_num)
                lines.append(line)
    except (UnicodeDecodeError, csv.Error):
        raise ConfigError(
            f"{path}: is not a CSV file: a line of names and rows of numbers in UTF-8, separated "
            "by commas"
        ) from None
    if not header or all(_is_number(name) for name in header):
        raise ConfigError(f"{path}, line 1: the first line must name the columns, as in t,x,u")
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise ConfigError(f"{path}, line 1: column {twice!r} is named twice; give distinct names")
    if not lines:
        raise ConfigError(f"{path}: it has names of columns, but no rows")
    return header, numbers, lines


def _number(cell: str, path: Path, line: int, name: str) -> float:
    text = cell.strip()
    try:
        return float(text) if text else np.nan
    except ValueError:
        if text.lower() in _BOOLS:
            return _BOOLS[text.lower()]
        raise ConfigError(
            f"{path}, line {line}: {name} is {text!r}, not a number; choose other columns, or "
            "convert it (times: to seconds)"
        ) from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
