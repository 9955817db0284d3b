"""The records that a study replays: those of a file, or the study's own, made by the teacher."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from jaxreplay.errors import ConfigError
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.plane.teacher import demonstrate
from jaxreplay.recordings.read import read
from jaxreplay.records import Records
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.factors import choose_records
from jaxreplay.study.runs import runs_of, taught_by
from jaxreplay.study.store import RESULTS_FORMAT


def record(params: PlaneParams, positions: np.ndarray, seed: int) -> Records:
    """Return the teacher's demonstrations, with the cube at each position `[N, 2]` in m.

    Raises:
        RuntimeError: a demonstration ended without the cube lifted.
    """
    made = demonstrate(params, positions, seed)
    return Records.from_sequences(
        made.sensors, made.commands, SENSOR_NAMES, COMMAND_NAMES, params.control_period
    )


def demonstrations(config: StudyConfig, folder: Path) -> dict[PlaneParams, Records]:
    """Return the records that a study replays, by the robot that made them.

    They are those in the config's file; without one, the study's own. These are made by the
    teacher, with each robot that a run is taught by (see :func:`jaxreplay.study.runs.taught_by`),
    and saved in `folder`, if they are not there yet.

    Raises:
        ConfigError: the config's file is missing, does not contain records of the plane's sensors
            and commands at its control period, or contains fewer than the study replays; or a
            demonstration by the teacher failed.
    """
    runs = runs_of(config)
    robots = dict.fromkeys(taught_by(config, runs, k) for k in range(len(runs)))
    return {robot: _demonstrated(config, folder, robot) for robot in robots}


def _demonstrated(config: StudyConfig, folder: Path, robot: PlaneParams) -> Records:
    """Return the records in the config's file, or those made with a robot."""
    path = config.demonstrations or folder / _file_name(config, robot)
    if config.demonstrations and not path.is_file():
        raise ConfigError(
            f"{path}: there is no such file of demonstrations; put it back, or start in the folder "
            "in which the study was run"
        )
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        try:
            record(robot, DEMONSTRATED, config.seed).save(path)
        except RuntimeError as error:
            settings = ", ".join(f"{name} {getattr(robot, name):g}" for name in SETTINGS)
            raise ConfigError(
                f"{error} (with {settings}); choose another seed than {config.seed}, a robot that "
                'can be taught, or taught = "nominal"'
            ) from None
    records = read(path)
    _check(records, path, config.plane)
    for value in config.axes.get("records", (config.fixed.get("records"),)):
        if value is not None:
            try:
                choose_records(value, records.n_records, config.seed, 0)
            except ValueError as error:
                raise ConfigError(f"{error} (of {path})") from None
    return records


def _file_name(config: StudyConfig, robot: PlaneParams) -> str:
    """Return a name with a hash of all that determines demonstrations.

    So a file made with other settings is not reused.
    """
    made_by = json.dumps([RESULTS_FORMAT, config.seed, DEMONSTRATED.tolist(), asdict(robot)])
    return f"demonstrations_{hashlib.sha256(made_by.encode()).hexdigest()[:12]}.npz"


def _check(records: Records, path: Path, plane: PlaneParams) -> None:
    for names, wanted, what in (
        (records.sensor_names, SENSOR_NAMES, "sensors"),
        (records.command_names, COMMAND_NAMES, "commands"),
    ):
        if names != wanted:
            raise ConfigError(
                f"{path}: its {what} are {', '.join(names)}; the simulated robot has "
                f"{', '.join(wanted)}, and can replay no others"
            )
    if records.period not in (None, plane.control_period):
        raise ConfigError(
            f"{path}: its rows are {records.period} s apart; the plane's control period is "
            f"{plane.control_period} s: resample them"
        )
