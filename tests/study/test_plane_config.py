"""A study described from Python, and the constants of the plane in a study."""

from dataclasses import asdict

import numpy as np
import pytest
from study_helpers import made_up_study, write

import jaxreplay as jr
from jaxreplay import cli
from jaxreplay.errors import ConfigError
from jaxreplay.plane.params import PlaneParams
from jaxreplay.study.config import StudyConfig, load_config
from jaxreplay.study.open import config_of
from jaxreplay.study.runs import runs_of, worlds_of
from jaxreplay.study.store import read_manifest

THETA = {"theta_i": [0.1]}
TEXT = """
positions = [[0.3, 0.0]]
records = 6
[axis]
theta_i = [0.1, 0.01]
[plane]
control_period = 0.2
area = [-0.25, 0.9, -0.4, 0.4]
"""


def test_one_axis_is_a_study_by_the_defaults_of_a_file(tmp_path):
    assert StudyConfig(axes=THETA) == load_config(write(tmp_path, "[axis]\ntheta_i = [0.1]"))


def test_a_study_from_python_is_that_of_the_file(tmp_path):
    plane = {"control_period": 0.2, "area": (-0.25, 0.9, -0.4, 0.4)}
    for constants in (plane, PlaneParams(**plane)):
        ours = StudyConfig(
            axes={"theta_i": np.array([0.1, 0.01])},
            fixed={"records": 6},
            positions=np.array([[0.3, 0.0]]),
            plane=constants,
        )
        assert ours == load_config(write(tmp_path, TEXT))
    assert ours.plane.control_period == 0.2


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "theta_i is missing"),
        ({"axes": {"theta_i": [2]}}, r"axis.theta_i\[0\] must be in \[0, 1\]; got 2"),
        ({"axes": {"theta_j": [0.1]}}, r"axis.theta_j; did you mean axis.theta_i\?"),
        ({"axes": THETA, "fixed": {"theta_i": 0.1}}, "both given; keep one"),
        ({"axes": THETA, "repeats": 0}, "repeats must be a whole number"),
        ({"axes": [0.1]}, "axes must map factors to values"),
        ({"axes": THETA, "plane": {"mas": 1}}, r"plane.mas; did you mean plane.mass\?"),
        ({"axes": THETA, "plane": {"mass": -1}}, "plane.mass must be greater than 0; got -1"),
        ({"axes": THETA, "plane": {"mass": "a"}}, "plane.mass must be a number"),
        ({"axes": THETA, "plane": {"area": [0, 1]}}, "plane.area must be 4 numbers"),
        ({"axes": THETA, "plane": {"area": [0, 1, 0, 1]}}, "plane.area must contain the robot"),
        ({"axes": THETA, "plane": {"substeps": 1.5}}, "plane.substeps must be a whole number"),
        ({"axes": THETA, "plane": {"mass": float("nan")}}, "plane.mass must be finite"),
        ({"axes": THETA, "plane": PlaneParams(motor_unit=0.02)}, "motor_unit is a factor"),
    ],
)
def test_a_mistake_is_told_as_of_a_file(given, message):
    with pytest.raises(ConfigError, match=message):
        StudyConfig(**given)


def test_a_factor_is_refused_among_the_constants_of_a_file(tmp_path, capsys):
    path = write(tmp_path, "theta_i = 0.1\n[plane]\nbattery = 1.0")
    assert cli.main(["run", str(path)]) == 2
    assert (
        "plane.battery is a factor: give it as battery or axis.battery" in capsys.readouterr().err
    )


def test_the_constants_belong_to_the_studys_identity_and_reach_its_worlds(tmp_path):
    config = load_config(write(tmp_path, TEXT))
    made_up_study(tmp_path / "study.toml", tmp_path / "out")
    manifest = read_manifest(tmp_path / "out")
    assert manifest["plane"]["control_period"] == 0.2
    assert "plane" not in manifest["config"]
    assert config_of(jr.open_study(tmp_path / "out")) == config
    worlds = worlds_of(config, runs_of(config).of(np.array([0])))
    assert asdict(worlds.unwrapped.params) == asdict(config.plane)
