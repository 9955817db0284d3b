"""Records from a user's files, of whatever format."""

import re
from collections.abc import Callable, Mapping, Sequence
from glob import glob
from pathlib import Path
from typing import Literal

from jaxreplay.errors import ConfigError
from jaxreplay.recordings.formats.csv import read_csv
from jaxreplay.recordings.formats.hdf5 import read_hdf5
from jaxreplay.recordings.formats.npz import read_npz
from jaxreplay.recordings.formats.parquet import INFO, read_parquet
from jaxreplay.recordings.formats.recording import Recording, Wanted
from jaxreplay.recordings.formats.times import at_one_rate
from jaxreplay.records import Records
from jaxreplay.records.arrays import both, one_row_later
from jaxreplay.records.resample import resample

FORMATS: dict[str, Callable[[Path, Wanted], Recording]] = {  # by the suffix of a file
    ".npz": read_npz,
    ".csv": read_csv,
    ".parquet": read_parquet,
    ".hdf5": read_hdf5,
    ".h5": read_hdf5,
}
_MINARI = Path("data", "main_data.hdf5")  # in the folder of a dataset

Names = str | Sequence[str] | None


def read(
    path: str | Path | Sequence[str | Path],
    sensors: Names = None,
    commands: Names = None,
    *,
    angles: str | Sequence[str] = (),
    period: float | None = None,
    episode: str | None = None,
    time: str | None = None,
    observed: Literal["before", "after"] | None = None,
) -> Records:
    """Return the records in files of one format, which their suffix tells.

    ============== ============================================ =================================
    `.npz`         written by :meth:`jaxreplay.Records.save`    observed after its command
    `.csv`         a line of names, then rows of numbers        observed after
    `.parquet`     LeRobot (or other columns of numbers)        observed before its command
    `.hdf5`, `.h5` robomimic, Minari                            observed before
    ============== ============================================ =================================

    Where observations are made before their commands, rows are aligned by
    :meth:`jaxreplay.Records.from_steps`, which says what is lost.

    Args:
        path: a file, several, a pattern such as `"demos/*.csv"`, or a folder: of files of one
            format, or of a LeRobot or Minari dataset.
        sensors: names of columns in the order wanted. A column of vectors gives all its elements;
            one of them is `"observation.state[0]"`, or the name that a LeRobot dataset gives it.
            Needed for `.csv`; by default all that the format knows as observations.
        commands: likewise; by default all that the format knows as actions.
        angles: those sensors, in rad, that become two each: `cos(name)` and `sin(name)`.
        period: time between rows in s: where a file has no times this states it, and where it has,
            episodes are resampled to it. By default the first episode's.
        episode: column whose value tells episodes apart (`.parquet`: by default `episode_index`);
            without one, each file is an episode.
        time: column of times in s (`.parquet`: by default `timestamp`).
        observed: whether the observation in a row is made before or after its command, where it
            is not as in the table.

    Warns:
        UserWarning: no period is given, and episodes of another rate than the first are resampled
            (see :mod:`jaxreplay.records.resample`).

    Raises:
        ConfigError: a file is missing, cannot be read or lacks a column of a name; times are
            uneven; a library is not installed; values are no records (see
            :meth:`jaxreplay.Records.from_sequences`). It is a ValueError.
    """
    wanted = Wanted(_names(sensors), _names(commands), _names(angles) or (), episode, time)
    try:
        files = files_of(path)
        whole = wanted == Wanted() and period is None and observed is None and len(files) == 1
        if whole and FORMATS.get(files[0].suffix, read_npz) is read_npz:
            return Records.load(files[0])
        return _records(files, wanted, period, observed)
    except ConfigError:
        raise
    except (FileNotFoundError, ValueError) as error:
        raise ConfigError(str(error)) from None


def files_of(path: str | Path | Sequence[str | Path]) -> list[Path]:
    """Return the files that a path, a pattern, a folder or a list of them stands for.

    Files that a pattern or a folder gives are in the order of their names, 2 before 10.

    Raises:
        ConfigError: there is none, or a folder has files of several formats.
    """
    if not isinstance(path, str | Path | Mapping):
        files = [file for each in path for file in files_of(each)]
        if not files:
            raise ConfigError("no file is given; give at least one")
        return files
    if isinstance(path, Mapping):
        raise ConfigError("the path is a dict; give a file's path, or a list of paths")
    given = Path(path)
    if given.is_dir():
        return _files_in(given)
    if any(letter in str(path) for letter in "*?[") and not given.exists():
        files = sorted(map(Path, glob(str(path), recursive=True)), key=_natural)
        if not files:
            raise ConfigError(f"{path}: no file has such a name")
        return files
    if given.suffix in FORMATS and given.suffix != ".npz" and not given.exists():
        raise ConfigError(f"{path}: there is no such file")
    if given.suffix not in FORMATS and given.is_file():
        with open(given, "rb") as stream:
            if stream.read(4) != b"PK\x03\x04":  # Records.save takes any name
                raise ConfigError(
                    f"{path} does not contain records: its name must end in one of "
                    f"{', '.join(FORMATS)}"
                )
    return [given]


def _files_in(folder: Path) -> list[Path]:
    if (folder / INFO).is_file():
        files = [*(folder / "data").rglob("*.parquet")]
    elif (folder / _MINARI).is_file():
        files = [folder / _MINARI]
    else:
        files = [file for file in folder.iterdir() if file.suffix in FORMATS and file.is_file()]
    found = sorted({file.suffix for file in files})
    if len(found) != 1:
        which = "without such a file" if not found else f"with some of {', '.join(found)}"
        raise ConfigError(
            f"{folder} is a folder {which}; give one with files of one format of "
            f"{', '.join(FORMATS)}, or the files"
        )
    return sorted(files, key=_natural)


def _records(
    files: list[Path],
    wanted: Wanted,
    period: float | None,
    observed: Literal["before", "after"] | None,
) -> Records:
    if observed not in ("before", "after", None):
        raise ConfigError(f"observed must be 'before' or 'after'; got {observed!r}")
    suffixes = sorted({file.suffix for file in files})
    if len(suffixes) > 1:
        raise ConfigError(f"files of several formats: {', '.join(suffixes)}; read one at a time")
    reader = FORMATS.get(suffixes[0], read_npz)
    recordings = [reader(files[0], wanted)]
    chosen = recordings[0].selection
    wanted = wanted._replace(  # the others have the names and the order of the first
        sensors=[part.name for part in chosen.sensors],
        commands=chosen.command_names(),
        angles=[part.name for part in chosen.angles],
    )
    recordings += [reader(file, wanted) for file in files[1:]]
    episodes, ratios, period = at_one_rate([e for r in recordings for e in r.episodes], period)
    order = recordings[0].observed if observed is None else observed
    aligned = one_row_later if order == "before" else both
    try:
        rows = aligned([e.observations for e in episodes], [e.actions for e in episodes])
        each = zip(*rows, ratios, strict=True)
        pairs = [(s, c) if ratio == 1 else resample(s, c, ratio) for s, c, ratio in each]
        return Records.from_sequences(
            [s for s, _ in pairs],
            [c for _, c in pairs],
            chosen.sensor_names(),
            chosen.command_names(),
            period,
        )
    except ValueError as error:
        record = re.match(r"record (\d+): ", str(error))
        where = files[0] if record is None else episodes[int(record[1])].where
        message = str(error)[record.end() :] if record else str(error)
        raise ConfigError(f"{where}: {message}") from None


def _names(given: Names) -> Sequence[str] | None:
    return (given,) if isinstance(given, str) else None if given is None else tuple(given)


def _natural(path: Path) -> list[str | int]:
    """Return a key that puts 2 before 10."""
    return [int(p) if p.isdecimal() else p for p in re.split(r"(\d+)", str(path))]
