"""Arguments and their checks that several commands share."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from jaxreplay.errors import ConfigError

if TYPE_CHECKING:
    import xarray as xr

Commands = argparse._SubParsersAction  # argparse has no public name for it


def count(text: str) -> int:
    """Read a whole number of 1 or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, 1 or more; got {text}")
    return int(text)


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
    missing = int((dataset.outcome == "").sum())
    if missing:
        print(f"{folder}: {missing} of {dataset.outcome.size} runs are missing", file=sys.stderr)
    return dataset
