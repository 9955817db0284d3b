"""The pictures of a notebook: of a study, of records, and of one run in motion."""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import xarray as xr

from jaxreplay.figures.animation import Animation, animate
from jaxreplay.figures.draw import main_figure
from jaxreplay.figures.inspection import inspection_figure
from jaxreplay.figures.maps import position_map
from jaxreplay.figures.picture import Picture
from jaxreplay.recordings.inspect import inspect
from jaxreplay.records import Records
from jaxreplay.study.again import find_and_run_again
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.open import open_study


def plot(study: xr.Dataset | str | Path) -> Picture:
    """Return the main figure of a study: the paper's figure 3, or a map of two factors.

    Args:
        study: its dataset, or its folder.
    """
    (figure,) = main_figure(_dataset(study)).values()
    return figure


def plot_map(study: xr.Dataset | str | Path) -> Picture:
    """Return a map of success by the cube's position, with a panel for each cell of the study.

    Args:
        study: its dataset, or its folder.
    """
    return position_map(_dataset(study))


def plot_records(records: Records) -> Picture:
    """Return a figure of records over time, with what is unusual in them marked."""
    return inspection_figure(records, inspect(records))


def watch(
    study: StudyConfig | str | Path,
    run: int | str | Mapping[str, Any] = 0,
    speed: float = 4.0,
) -> Animation:
    """Do one run of a study again, and return an animation of it.

    Args:
        study: the folder of a study, or the description of one, which need not have been run.
        run: its index; an outcome or a stall, such as `"S"` or `"fixed"`, for the first run that
            ended so; or values, such as `{"jump": "own_tau", "position": 0, "repeat": 2}`.
        speed: as a multiple of real time.

    Raises:
        ConfigError: there is no such run; or the study has another results format.
        FileNotFoundError: there is no study in the folder.
    """
    if isinstance(study, StudyConfig):
        with TemporaryDirectory() as folder:
            _, trace = find_and_run_again(study, run, Path(folder))
    else:
        _, trace = find_and_run_again(Path(study), run, Path(study))
    return animate(trace, speed)


def _dataset(study: xr.Dataset | str | Path) -> xr.Dataset:
    return study if isinstance(study, xr.Dataset) else open_study(study)
