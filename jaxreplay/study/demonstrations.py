"""The records that a study replays: those of a file, or the study's own, made by the teacher."""

import hashlib
import json
import warnings
from dataclasses import asdict
from pathlib import Path

import numpy as np

from jaxreplay.errors import ConfigError
from jaxreplay.loop.checks import check_end
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.plane.teacher import demonstrate
from jaxreplay.recordings.findings.whole import ends
from jaxreplay.recordings.inspect import columns_of, table_of
from jaxreplay.recordings.read import read
from jaxreplay.records import Records
from jaxreplay.study.config import StudyConfig, check_sigma
from jaxreplay.study.factors import choose_records
from jaxreplay.study.file import name_of, records_in
from jaxreplay.study.runs import Demonstrations, runs_of, taught_by
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


def demonstrations(config: StudyConfig, folder: Path) -> Demonstrations:
    """Return the records that a study replays.

    They are those in the config's file; without one, the study's own. These are made by the
    plane's teacher, with each robot that a run is taught by (see
    :func:`jaxreplay.study.runs.taught_by`), and saved in `folder`, if they are not there yet.

    Raises:
        ConfigError: the config's file is missing, does not contain records that can be replayed in
            the study's world, or contains fewer than the study replays; or a demonstration by the
            teacher failed.
    """
    runs = runs_of(config)
    robots = dict.fromkeys(taught_by(config, runs, k) for k in range(len(runs)))
    return {robot: _demonstrated(config, folder, robot) for robot in robots}


def _demonstrated(config: StudyConfig, folder: Path, robot: PlaneParams | None) -> Records:
    """Return the records made with a robot; None: those in the config's file."""
    if robot is None:
        assert config.demonstrations is not None
        file, records = name_of(config.demonstrations), records_in(config.demonstrations)
    else:
        _check_records(config, len(DEMONSTRATED), "the teacher's demonstrations")
        path = folder / _file_name(config, robot)
        if not path.exists():
            _demonstrate(config, path, robot)
        file, records = f"{path}", read(path)
    config.world.check(records, file)
    _check_records(config, records.n_records, file)
    try:
        for value in config.values_of("last_steps"):
            check_end(records, value or None)
        check_sigma(config, records.sensor_names)
    except ValueError as error:
        raise ConfigError(f"{error} (of {file})") from None
    if config.environment is not None:
        _warn_of_ends(config, records, file)
    return records


def _check_records(config: StudyConfig, n: int, where: str) -> None:
    """Check that each choice of records is possible with n of them.

    Raises:
        ConfigError: one is not.
    """
    for value in config.values_of("records"):
        try:
            if value is not None:
                choose_records(value, n, config.seed, 0)
        except ValueError as error:
            raise ConfigError(f"{error} (of {where})") from None


def _warn_of_ends(config: StudyConfig, records: Records, file: str) -> None:
    """Warn of records that end in motion, where replays would end before them."""
    if max(config.values_of("last_steps")) > 1:
        rows = table_of(records)
        for found in ends(rows, columns_of(rows, records.sensor_names, records.command_names)):
            warnings.warn(f"{file}: {found.text} (0: the environment alone ends it)", stacklevel=2)


def _demonstrate(config: StudyConfig, path: Path, robot: PlaneParams) -> None:
    """Let the teacher demonstrate, and save the records."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        record(robot, DEMONSTRATED, config.seed).save(path)
    except RuntimeError as error:
        settings = ", ".join(f"{name} {getattr(robot, name):g}" for name in SETTINGS)
        raise ConfigError(
            f"{error} (with {settings}); choose another seed than {config.seed}, a robot that "
            'can be taught, or taught = "nominal"'
        ) from None


def _file_name(config: StudyConfig, robot: PlaneParams) -> str:
    """Return a name with a hash of all that determines demonstrations.

    So a file made with other settings is not reused.
    """
    made_by = json.dumps([RESULTS_FORMAT, config.seed, DEMONSTRATED.tolist(), asdict(robot)])
    return f"demonstrations_{hashlib.sha256(made_by.encode()).hexdigest()[:12]}.npz"
