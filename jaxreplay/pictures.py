"""The pictures of a notebook: of a study, of records, and of one run in motion."""

from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import xarray as xr

from jaxreplay.errors import ConfigError
from jaxreplay.figures.animation import animate, still
from jaxreplay.figures.draw import main_figure
from jaxreplay.figures.inspection import inspection_figure
from jaxreplay.figures.maps import position_map
from jaxreplay.figures.picture import Picture
from jaxreplay.page.run import page
from jaxreplay.recordings.inspect import inspect
from jaxreplay.records import Records
from jaxreplay.study.again import find_and_run_again
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.dataset import Trace
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


class Watched(NamedTuple):
    """A run to be watched: in a notebook, or in a file.

    Attributes:
        run: step by step.
        speed: as a multiple of real time.
    """

    run: Trace
    speed: float

    def save(
        self, path: str | Path, progress: Callable[[int, int], None] = lambda done, total: None
    ) -> None:
        """Save the run as a page, an animation, or a picture of its last step.

        Args:
            path: it ends in `.html`, `.gif` or `.png`.
            progress: called after each frame of an animation with the frames done and their total.

        Raises:
            ConfigError: the path ends otherwise.
        """
        path = Path(path)
        check_suffix(path)
        if path.suffix == ".html":
            path.write_text(page(self.run, self.speed), "utf-8")
        elif path.suffix == ".gif":
            animate(self.run, self.speed, progress).save(path)
        else:
            still(self.run).save(path)

    def _repr_html_(self) -> str:
        inside = escape(page(self.run, self.speed))
        return f'<iframe srcdoc="{inside}" style="width: 100%; height: 640px; border: 0"></iframe>'


def check_suffix(path: Path) -> None:
    """Check that a run can be saved in a file of this name.

    Raises:
        ConfigError: it cannot.
    """
    if path.suffix not in (".html", ".gif", ".png"):
        raise ConfigError(
            f"{path}: its name must end in .html for a page, .gif for an animation, or .png for a "
            "picture of the end"
        )


def watch(
    study: StudyConfig | str | Path,
    run: int | str | Mapping[str, Any] = 0,
    speed: float = 4.0,
) -> Watched:
    """Do one run of a study again, and return it: a notebook plays it, and `save` stores it.

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
    return Watched(trace, speed)


def _dataset(study: xr.Dataset | str | Path) -> xr.Dataset:
    return study if isinstance(study, xr.Dataset) else open_study(study)
