"""The `.npz` file of :class:`Records`, read and checked."""

import zipfile
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

LARGEST = 2**31  # bytes of all arrays
_KINDS = {  # of the arrays in a file: the kinds of types that each may have, and its dimensions
    "sensors": ("fiu", 2),
    "commands": ("fiu", 2),
    "lengths": ("iu", 1),
    "period": ("f", 0),
    "sensor_names": ("U", 1),
    "command_names": ("U", 1),
}


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
            with zipfile.ZipFile(stream) as file:
                _check_sizes(file)
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as file:
                parts = {name: file[name] for name in _KINDS}
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
    except Exception as error:  # damaged bytes can raise anything
        cause = " ".join(f"{error}".split())[:200]
        raise ValueError(
            f"{path} does not contain records (truncated, or written by something else): {cause}"
        ) from error
    return Stored(sensors, commands, sensor_names, command_names, period)


def _check_sizes(file: zipfile.ZipFile) -> None:
    """Check types and sizes of the arrays by their headers, before memory is allocated for them.

    Raises:
        ValueError: an array is missing, of a wrong type, too large, or not as large as it says.
    """
    total = 0
    for name, (kinds, dimensions) in _KINDS.items():
        with file.open(f"{name}.npy") as member:
            shape, dtype = _header(member)
            size = prod(shape) * dtype.itemsize
            whole = member.tell() + size == file.getinfo(f"{name}.npy").file_size
        total += size
        if dtype.kind not in kinds or len(shape) != dimensions or not whole:
            raise ValueError(f"{name} is {dtype} {shape}, not of its type or size")
    if total > LARGEST:
        raise ValueError(f"its arrays take {total / 2**30:.3g} GiB; up to 2 can be read")


def _header(member: Any) -> tuple[tuple[int, ...], np.dtype]:
    """Return the shape and the type of an array in a file."""
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read = np.lib.format.read_array_header_2_0
    shape, _, dtype = read(member)
    return shape, dtype
