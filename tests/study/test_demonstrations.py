"""Demonstrations are made by the robot that replays them, unless the study says otherwise."""

import numpy as np
import pytest
from study_helpers import some_records

from jaxreplay.errors import ConfigError
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import NOMINAL
from jaxreplay.records import Records
from jaxreplay.study import demonstrations as module
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.runs import records_of, runs_of, shards_of

AXES = {"motor_unit": [0.005, 0.01], "dithering": [False, True], "theta_i": [0.1, 0.2]}


@pytest.fixture
def made(monkeypatch):
    """The robots for which demonstrations are made; record i of the k-th has rows of 100 k + i."""
    robots = []

    def record(params, positions, seed):
        robots.append(params)
        sensors, commands = some_records().sequences()
        return Records.from_sequences(
            [s + 100 * (len(robots) - 1) for s in sensors],
            commands,
            some_records().sensor_names,
            some_records().command_names,
        )

    monkeypatch.setattr(module, "record", record)
    return robots


def test_each_robot_of_a_study_is_taught_once_and_replays_its_own(made, tmp_path):
    config = StudyConfig(AXES)
    runs = runs_of(config)
    for _ in range(2):  # the second time they are read
        by_robot = demonstrations(config, tmp_path)
    assert len(made) == len(by_robot) == 4
    assert len(list(tmp_path.glob("demonstrations_*.npz"))) == 4
    for which in shards_of(config, runs, 56):
        some = runs.of(which)
        (unit,), (dithering,) = (set(some.values[name]) for name in ("motor_unit", "dithering"))
        index = int(records_of(config, by_robot, some).sequences()[0][0][0, 0]) // 100
        assert (made[index].motor_unit, made[index].dithering) == (unit, dithering)
        for name in SETTINGS:
            assert getattr(made[index], name) == some.values[name][0]


def test_the_nominal_robot_may_teach_all(made, tmp_path):
    config = StudyConfig(AXES | {"taught": ["nominal"]})
    assert len(demonstrations(config, tmp_path)) == len(made) == 1
    assert {name: getattr(made[0], name) for name in SETTINGS} == NOMINAL


def test_a_file_serves_all_robots(made, tmp_path):
    some_records().save(tmp_path / "mine.npz")
    config = StudyConfig(AXES, demonstrations=tmp_path / "mine.npz")
    (records,) = demonstrations(config, tmp_path / "out").values()
    assert not made
    np.testing.assert_array_equal(records.lengths, some_records().lengths)
    runs = runs_of(config)
    assert len(shards_of(config, runs, len(runs))) == 1


def test_a_robot_that_cannot_be_taught_is_one_line(monkeypatch, tmp_path):
    def record(params, positions, seed):
        raise RuntimeError("the demonstration with the cube at (0.300, 0.000) m failed")

    monkeypatch.setattr(module, "record", record)
    with pytest.raises(ConfigError, match=r"failed \(with motor_unit 0\.2, .*taught = \"nominal\""):
        demonstrations(StudyConfig({"theta_i": [0.1]}, {"motor_unit": 0.2}), tmp_path)
