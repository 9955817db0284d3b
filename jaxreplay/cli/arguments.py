"""Arguments and their checks that several commands share."""

import argparse
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from jaxreplay.errors import ConfigError

if TYPE_CHECKING:
    import xarray as xr

    from jaxreplay.records import Records

Commands = argparse._SubParsersAction  # argparse has no public name for it


def count(text: str) -> int:
    """Read a whole number of 1 or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, 1 or more; got {text}")
    return int(text)


def seconds(text: str) -> float:
    """Read a time in s, 0 or more."""
    value = float(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be 0 s or more; got {text}")
    return value


def address(text: str) -> str:
    """Read the address of a scheduler."""
    if not re.fullmatch(r"((tcp|tls|ucx|ws|wss)://)?[^\s/:]+:\d+|\w+://\S+", text):
        raise argparse.ArgumentTypeError(
            f"must be an address, such as tcp://10.0.0.1:8786; got {text!r}"
        )
    return text


def speed(text: str) -> float:
    """Read how many times real time an animation runs."""
    value = float(text)
    if not 0.1 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"must be in [0.1, 1000]; got {text}")
    return value


def add_folder(parser: argparse.ArgumentParser) -> None:
    """Add the folder of a study."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="the folder of a study")


def opened(folder: Path) -> "xr.Dataset":
    """Return the dataset of a study; print on stderr how many runs are missing, if any."""
    from jaxreplay.study.open import open_study

    try:
        dataset = open_study(folder)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    if unverified := dataset.attrs["unverified"]:
        print(
            f"{folder}: {unverified} shards are of an older version, which stored no checksum: not "
            "verified",
            file=sys.stderr,
        )
    missing = int((dataset.outcome == "").sum())
    if missing:
        print(f"{folder}: {missing} of {dataset.outcome.size} runs are missing", file=sys.stderr)
    return dataset


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Add the files of recordings, and what to take of them: the arguments of `jaxreplay.read`."""
    parser.add_argument(
        "records",
        type=Path,
        nargs="+",
        metavar="RECORDS",
        help="an .npz file of Records.save; .csv, .parquet (LeRobot), or .hdf5 or .h5 files "
        "(robomimic, Minari); a folder of them, or of a LeRobot or Minari dataset",
    )
    group = parser.add_argument_group("which columns of the files, and how their rows are read")
    group.add_argument(
        "--sensors", type=_listed, metavar="NAMES", help="such as x,y (needed for .csv)"
    )
    group.add_argument("--commands", type=_listed, metavar="NAMES", help="such as u (likewise)")
    group.add_argument(
        "--angles",
        type=_listed,
        default=(),
        metavar="NAMES",
        help="sensors in rad that become two each: their cosine and sine",
    )
    group.add_argument(
        "--episode", metavar="COLUMN", help="its value tells the episodes in a file apart"
    )
    group.add_argument("--time", metavar="COLUMN", help="the time in s")
    group.add_argument(
        "--period",
        type=float,
        metavar="SECONDS",
        help="time between rows; episodes in files with times are resampled to it",
    )
    group.add_argument(
        "--observed",
        choices=("before", "after"),
        help="whether a row's observation is made before or after its command (default: after for "
        ".npz and .csv, before for the others)",
    )


def recordings(options: argparse.Namespace) -> "Records":
    """Return the records in the files given to a command; see :func:`add_recordings`."""
    from jaxreplay.recordings.read import read

    return read(
        options.records,
        options.sensors,
        options.commands,
        angles=options.angles,
        period=options.period,
        episode=options.episode,
        time=options.time,
        observed=options.observed,
    )


def first_of(options: argparse.Namespace) -> Path:
    """Return the first of the files given to a command, after which its output is named."""
    path = options.records[0]
    if any(letter in str(path) for letter in "*?[") and not path.exists():
        from jaxreplay.recordings.read import files_of

        return files_of(path)[0]
    return path if path.name else path.resolve()


def _listed(text: str) -> list[str]:
    """Read names that commas separate."""
    return [name.strip() for name in text.split(",")]
