"""The file of demonstrations that a study names: a path, or the arguments of `jaxreplay.read`."""

from collections.abc import Mapping
from inspect import signature
from pathlib import Path
from typing import Any

from jaxreplay.errors import ConfigError
from jaxreplay.recordings.read import read
from jaxreplay.records import Records
from jaxreplay.study.parse import known

File = Path | Mapping[str, Any]
_ARGUMENTS = ("file", *(name for name in signature(read).parameters if name != "path"))


def read_file(given: Any, key: str) -> File | None:
    """Read the name of a file, or a table of `file` and other arguments of `jaxreplay.read`."""
    if given is None:
        return None
    if isinstance(given, dict):
        known(given, _ARGUMENTS, f"{key}.")
        if not _are_paths(given.get("file")):
            raise ValueError(f"{key}.file must be a file's path, or a list of such; got {given!r}")
        return Path(given["file"]) if list(given) == ["file"] and _is_one(given) else given
    if not isinstance(given, str):
        raise ValueError(f"{key} must be a file's path, or a table with file; got {given!r}")
    return Path(given)


def relative(given: Any, folder: Path) -> Any:
    """Return the value of a study's file in a folder with its paths as seen from here."""
    if isinstance(given, str):
        return str(folder / given)
    if isinstance(given, dict) and _are_paths(given.get("file")):
        file = given["file"]
        each = str(folder / file) if _is_one(given) else [str(folder / one) for one in file]
        return given | {"file": each}
    return given  # wrong, which `read_file` says


def arguments_of(file: File | str) -> dict[str, Any]:
    """Return the arguments of `jaxreplay.read` that are given besides the path."""
    given = file if isinstance(file, Mapping) else {}
    return {name: value for name, value in given.items() if name != "file"}


def name_of(file: File) -> str:
    """Return the name of a file, for messages."""
    given = file["file"] if isinstance(file, Mapping) else file
    return ", ".join(given) if isinstance(given, list) else str(given)


def check_there(given: Any, key: str) -> None:
    """Check that the files that a study names exist; a pattern is not looked up.

    Raises:
        ValueError: one does not.
    """
    for path in _missing(read_file(given, key)):
        raise ValueError(f"{key}: there is no file {path}")


def records_in(file: File) -> Records:
    """Return the records in a study's file.

    Raises:
        ConfigError: there is no such file, or it does not contain such records.
    """
    for path in _missing(file):
        raise ConfigError(
            f"{path}: there is no such file of demonstrations; put it back, or start in the folder "
            "in which the study was run"
        )
    if isinstance(file, Path):
        return read(file)
    try:
        return read(file["file"], **arguments_of(file))
    except TypeError as error:
        raise ConfigError(f"demonstrations: {error}") from None


def _missing(file: File | None) -> list[str]:
    given = file["file"] if isinstance(file, Mapping) else file
    paths = [] if given is None else given if isinstance(given, list) else [given]
    plain = [str(path) for path in paths if not any(letter in str(path) for letter in "*?[")]
    return [path for path in plain if not Path(path).exists()]


def _is_one(given: Mapping[str, Any]) -> bool:
    return isinstance(given["file"], str)


def _are_paths(given: Any) -> bool:
    several = isinstance(given, list) and len(given) > 0 and all(isinstance(f, str) for f in given)
    return isinstance(given, str) or several
