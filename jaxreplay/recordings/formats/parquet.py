"""Parquet, as LeRobot stores its datasets, or with columns of numbers of any other names."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxreplay.errors import ConfigError, suggest
from jaxreplay.recordings.formats.recording import (
    Recording,
    Wanted,
    gather,
    labels,
    library,
    select,
)

EPISODE, FRAME, TIME = "episode_index", "frame_index", "timestamp"
INFO = Path("meta", "info.json")  # in the folder of a LeRobot dataset


def read_parquet(path: Path, wanted: Wanted) -> Recording:
    """Return the episodes in a file: one for each value of `episode_index`, or of `episode`.

    By default, sensors are the columns of numbers that begin with `observation`, commands `action`,
    and a row's observation is made before its action. The time is `timestamp`. Names of elements
    and the rate come from `meta/info.json`, where the file lies in the folder of a dataset.

    Raises:
        ConfigError: a name is unknown, pyarrow is not installed, or the file is not Parquet.
        ValueError: a frame of an episode is missing.
    """
    pyarrow, pq = library("pyarrow", "parquet"), library("pyarrow.parquet", "parquet")
    library("pyarrow.compute", "parquet")
    info = _info(path)
    try:
        with pq.ParquetFile(path) as file:
            schema = {field.name: field.type for field in file.schema_arrow}
            first = {name: _first(file, name, pyarrow) for name in schema}
            widths = {name: k for name, k in first.items() if k is not None}
            features = info.get("features", {})
            columns = {
                name: labels(name, k, features.get(name, {}).get("names"))
                for name, k in widths.items()
            }
            selection, extra = _selection(path, wanted, columns, schema)
            parts = [*selection.sensors, *selection.commands]
            needed = [*dict.fromkeys([*(part.column for part in parts), *extra.values()])]
            table = file.read(columns=needed)
    except (pyarrow.ArrowInvalid, pyarrow.ArrowNotImplementedError) as error:
        raise ConfigError(f"{path}: cannot be read as a Parquet file: {error}") from None

    if not table.num_rows:
        raise ConfigError(f"{path}: it has no rows")
    values = {name: _rows(table[name], name, path, pyarrow) for name in needed}
    episodes = []
    for where, rows in _groups(path, values, extra, table.num_rows):
        load = lambda name, rows=rows: values[name][rows]  # noqa: E731
        time = values[extra["time"]][rows] if "time" in extra else None
        fps = info.get("fps")
        period = 1 / fps if isinstance(fps, int | float) and fps > 0 else None
        episodes.append(gather(selection, where, load, load, time, period))
    return Recording(selection, episodes, "before")


def _selection(path: Path, wanted: Wanted, columns: dict[str, list[str]], schema: dict[str, Any]):
    """Return what is chosen, and the columns of `episode`, `frame` and `time`, where there are."""
    extra = {"episode": EPISODE, "frame": FRAME, "time": TIME}
    extra = {role: name for role, name in extra.items() if name in schema}
    for role, name in (("episode", wanted.episode), ("time", wanted.time)):
        if name is not None and name not in schema:
            raise ConfigError(f"{path}: no column is named {suggest(name, schema)}")
        if name is not None:
            extra[role] = name
    actions = {name: names for name, names in columns.items() if name.split(".")[0] == "action"}
    others = {name: names for name, names in columns.items() if name not in actions}
    sensors = [name for name in others if name.split(".")[0] == "observation"] or None
    commands = ["action"] if "action" in actions else None
    return select(wanted, str(path), others, actions, sensors, commands), extra


def _groups(path: Path, values: dict[str, Any], extra: dict[str, str], n: int):
    """Yield the name of each episode for errors, and its rows in order."""
    if "episode" not in extra:
        yield str(path), np.arange(n)
        return
    names, first, group = np.unique(
        values[extra["episode"]], return_index=True, return_inverse=True
    )
    for k in np.argsort(first):
        where, rows = f"{path}, episode {names[k]}", np.flatnonzero(group == k)
        if "frame" in extra:
            frames = values[extra["frame"]][rows]
            order = np.argsort(frames, kind="stable")
            rows, frames = rows[order], frames[order]
            if gaps := np.flatnonzero(np.diff(frames) != 1).tolist():
                a, b = frames[gaps[0]], frames[gaps[0] + 1]
                raise ValueError(
                    f"{where}: {extra['frame']} goes from {a} to {b}; each must be one more than "
                    "the one before; cut the episode there"
                )
        yield where, rows


def _info(path: Path) -> dict[str, Any]:
    """Return the description of the LeRobot dataset in which a file lies; {} without one."""
    for folder in [*path.absolute().parents][:3]:  # data/chunk-000/file-000.parquet
        if (folder / INFO).is_file():
            try:
                info = json.loads((folder / INFO).read_text(encoding="utf-8"))
            except ValueError as error:
                raise ConfigError(f"{folder / INFO}: is not JSON: {error}") from None
            features = info.get("features", {}) if isinstance(info, dict) else None
            if not isinstance(features, dict) or not all(
                isinstance(feature, dict) for feature in features.values()
            ):
                raise ConfigError(f"{folder / INFO}: does not describe a LeRobot dataset")
            return info
    return {}


def _first(file: Any, name: str, pyarrow: Any) -> int | None:
    """Return the number of elements of a column, 0 for single numbers, None if it is neither."""
    types, kind = pyarrow.types, file.schema_arrow.field(name).type

    def numeric(kind: Any) -> bool:
        return types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)

    if numeric(kind):
        return 0
    if types.is_fixed_size_list(kind) and numeric(kind.value_type):
        return kind.list_size
    if (types.is_list(kind) or types.is_large_list(kind)) and numeric(kind.value_type):
        batch = next(file.iter_batches(1, columns=[name]), None)
        row = None if batch is None or not batch.num_rows else batch.column(0)[0].as_py()
        return len(row) if row else None
    return None


def _rows(column: Any, name: str, path: Path, pyarrow: Any) -> np.ndarray:
    """Return a column as an array `[T]` or `[T, k]`; missing numbers are NaN."""
    types, kind = pyarrow.types, column.type
    if not (types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)):
        return column.to_numpy()
    widths = pyarrow.compute.list_value_length(column)
    if widths.null_count or len(widths.unique()) > 1:
        raise ValueError(f"{path}: {name} has vectors of different lengths; each row needs as many")
    values = [chunk.flatten().to_numpy(zero_copy_only=False) for chunk in column.chunks]
    return np.concatenate(values).reshape(len(column), -1)
