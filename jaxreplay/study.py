"""A study: a config turned into runs, and the runs into one labelled dataset on disk."""

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from itertools import product
from pathlib import Path

import numpy as np
import xarray as xr

from jaxreplay.config import ConfigError, StudyConfig
from jaxreplay.params import Params
from jaxreplay.plane.demonstrator import DEMONSTRATED, TESTED, facing, record
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, SENSOR_RANGES, PlaneParams
from jaxreplay.plane.world import Plane
from jaxreplay.records import Records
from jaxreplay.replay import OUTCOMES, replay

DATASET = "study.nc"
_RUNS = 2  # keeps the runs' random streams apart from the demonstrations'


def demonstrations(config: StudyConfig, folder: Path) -> Records:
    """The records to replay: the file the config names, or the study's own, made if absent.

    Raises:
        ConfigError: the file does not hold records of the plane's sensors and commands.
    """
    plane = PlaneParams()
    # Named for all that made them, so that none made otherwise is taken for them.
    made_by = json.dumps([version("jaxreplay"), config.seed, DEMONSTRATED.tolist(), asdict(plane)])
    own = folder / f"demonstrations_{hashlib.sha256(made_by.encode()).hexdigest()[:12]}.npz"
    path = config.demonstrations or own
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        try:
            records, _ = record(plane, DEMONSTRATED, config.seed)
        except RuntimeError as error:
            raise ConfigError(f"{error}; choose another seed than {config.seed}") from None
        records.save(path)
    try:
        records = Records.load(path)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    for held, wanted, what in (
        (records.sensor_names, SENSOR_NAMES, "sensors"),
        (records.command_names, COMMAND_NAMES, "commands"),
    ):
        if held != wanted:
            raise ConfigError(
                f"{path}: its {what} are {', '.join(held)}; the plane has {', '.join(wanted)}, "
                "and can replay no others"
            )
    if records.period not in (None, plane.control_period):
        raise ConfigError(
            f"{path}: its rows are {records.period} s apart; the plane's control period is "
            f"{plane.control_period} s: resample them"
        )
    return records


def run_study(
    config: StudyConfig,
    folder: str | Path,
    progress: Callable[[str, int, np.ndarray], None] = lambda jump, step, outcome: None,
) -> xr.Dataset:
    """Run all of a study, one batch per reading of a jump, and write it to a folder.

    Every run has a random stream of its own, keyed by the seed and the run's place in the
    grid of θ_I × position × repeat; both readings meet the same ones.

    Args:
        config: the study.
        folder: made if absent; what else lies in it is left alone.
        progress: called after each control step of a batch with the reading, the step and the
            outcomes so far.

    Returns:
        What :func:`open_study` gives.

    Raises:
        ConfigError: the demonstrations named by the config do not fit.
        OSError: the folder cannot be written.
    """
    folder = Path(folder)
    records = demonstrations(config, folder)
    folder.mkdir(parents=True, exist_ok=True)
    plane = PlaneParams()
    grid = list(product(config.theta_i, range(len(TESTED)), range(config.repeats)))
    theta_i, position, _ = (np.array(column) for column in zip(*grid, strict=True))
    n = len(grid)
    params = Params(
        theta_i=theta_i,
        theta_tau=np.full(n, config.theta_tau),
        sigma=np.tile(config.sigma * np.array(SENSOR_RANGES), (n, 1)),
    )
    cubes = facing(TESTED[position])
    keys = [(config.seed, _RUNS, run) for run in range(n)]
    results = [
        replay(
            records,
            params,
            Plane(plane, cubes, keys),
            jump,
            lambda step, outcome, jump=jump: progress(jump, step, outcome),
        )
        for jump in config.jump
    ]

    shape = (len(config.theta_i), len(TESTED), config.repeats)
    dims = ("jump", "theta_i", "position", "repeat")
    described = {
        "outcome": {"long_name": "outcome of the run", "values": " ".join(OUTCOMES)},
        "alignment_error": {"units": "mm", "long_name": "alignment error"},
        "duration": {"units": "s", "long_name": "run duration"},
        "log_evidence": {"units": "1", "long_name": "log p(Z_1:t) of the run"},
    }
    dataset = xr.Dataset(
        {
            name: (dims, np.stack([getattr(r, name).reshape(shape) for r in results]), attributes)
            for name, attributes in described.items()
        },
        coords={
            "jump": list(config.jump),
            "theta_i": ("theta_i", list(config.theta_i), {"long_name": "θ_I", "units": "1"}),
            "position": np.arange(len(TESTED)),
            "repeat": np.arange(config.repeats),
            "cube_x": ("position", TESTED[:, 0], {"units": "m", "long_name": "cube, ahead"}),
            "cube_y": ("position", TESTED[:, 1], {"units": "m", "long_name": "cube, to the left"}),
        },
        attrs={
            "config": json.dumps(asdict(config), default=str),
            "plane": json.dumps(asdict(plane)),
            "jaxreplay": version("jaxreplay"),
            "widened": sum(result.widened for result in results),
        },
    ).transpose("theta_i", "jump", "position", "repeat")
    part = folder / f"{DATASET}.part"
    dataset.to_netcdf(part, engine="scipy")
    os.replace(part, folder / DATASET)
    return dataset


def open_study(folder: str | Path) -> xr.Dataset:
    """The dataset of a study, wholly read; `folder` may also be the file itself.

    Returns:
        Variables `outcome` (S, Fs, Fg or Fb), `alignment_error` (mm, NaN unless S), `duration`
        (s) and `log_evidence` over the dimensions `theta_i`, `jump`, `position` and `repeat`.

    Raises:
        FileNotFoundError: there is no study in the folder.
        ValueError: its file is truncated, or not one of a study.
    """
    path = Path(folder)
    path = path if path.is_file() else path / DATASET
    if not path.is_file():
        raise FileNotFoundError(
            f"no study in {folder}: {path.name} is missing; jaxreplay run makes it"
        )
    try:
        with xr.open_dataset(path, engine="scipy") as dataset:
            dataset = dataset.load()
        dataset["outcome"] = dataset.outcome.astype("<U2")
        return dataset
    except (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
        raise ValueError(f"{path} does not hold a study (truncated?): {error}") from error


def table(dataset: xr.Dataset) -> str:
    """The study in words: for each reading and θ_I how runs ended, and how well and how fast."""
    lines = []
    for jump in dataset.jump.values:
        lines += [
            f"jump = {jump}",
            f"{'θ_I':>9}"
            + "".join(f"{name:>5}" for name in OUTCOMES)
            + f"{'error of S, mm':>18}{'duration of S, s':>20}",
        ]
        for theta_i in dataset.theta_i.values:
            runs = dataset.sel(jump=jump, theta_i=theta_i)
            outcome = runs.outcome.values.ravel()
            row = f"{theta_i:9.2e}" + "".join(f"{np.sum(outcome == o):5d}" for o in OUTCOMES)
            for name, width in (("alignment_error", 18), ("duration", 20)):
                row += mean_and_error(runs[name].values.ravel()[outcome == "S"]).rjust(width)
            lines.append(row)
        lines.append("")
    return "\n".join([*lines, "± is the standard error of the mean"])


def mean_and_error(values: np.ndarray) -> str:
    """`mean ± standard error`, as far as there are values."""
    if len(values) == 0:
        return "–"
    if len(values) == 1:
        return f"{values[0]:.2f}"
    return f"{values.mean():.2f} ± {standard_error(values):.2f}"


def standard_error(values: np.ndarray) -> float:
    """Of the mean; NaN for fewer than two values."""
    return values.std(ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan
