"""The `.npz` file of :class:`Records`, read and checked."""

import zipfile
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

_BROKEN = (KeyError, ValueError, TypeError, OSError, EOFError, zipfile.BadZipFile, zlib.error)


class Stored(NamedTuple):
    """Contents of a file, in the order in which `Records.from_sequences` takes them.

    Attributes:
        sensors: N arrays `[L_i, n_s]`.
        commands: N arrays `[L_i, n_u]`.
        sensor_names: `[n_s]`.
        command_names: `[n_u]`.
        period: time between rows in s; None if unknown.
    """

    sensors: list[np.ndarray]
    commands: list[np.ndarray]
    sensor_names: list[str]
    command_names: list[str]
    period: float | None


def stored(path: str | Path) -> Stored:
    """Return the contents of a file that `Records.save` wrote.

    Raises:
        OSError: there is no such file, or it cannot be opened.
        ValueError: the file is truncated, or does not contain records.
    """
    try:
        with open(path, "rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise ValueError("it is not a whole .npz file")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as file:
                parts = {name: file[name] for name in file.files}
        lengths = parts["lengths"]
        cuts = np.cumsum(lengths)[:-1]
        if np.min(lengths) < 1:
            raise ValueError("one of its lengths is less than 1")
        period = None if np.isnan(float(parts["period"])) else float(parts["period"])
        for name in ("sensors", "commands"):
            if len(parts[name]) != np.sum(lengths):
                raise ValueError(f"its lengths do not add up to its number of {name} rows")
        sensors, commands = (np.split(parts[k], cuts) for k in ("sensors", "commands"))
        sensor_names = [str(name) for name in parts["sensor_names"]]
        command_names = [str(name) for name in parts["command_names"]]
    except FileNotFoundError:
        raise FileNotFoundError(f"no records file {path}") from None
    except (PermissionError, IsADirectoryError):
        raise
    except _BROKEN as error:
        cause = "(truncated, or written by something else)"
        raise ValueError(f"{path} does not contain records {cause}: {error}") from error
    return Stored(sensors, commands, sensor_names, command_names, period)
