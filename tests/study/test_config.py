import numpy as np
import pytest
from study_helpers import SMALL, TUNED, VARIED, write

from jaxreplay.errors import ConfigError
from jaxreplay.study.config import load_config
from jaxreplay.study.runs import runs_of
from jaxreplay.study.worlds.plane import PLANE_FACTORS as FACTORS


def test_the_shipped_experiment_is_the_papers(request):
    config = load_config(request.config.rootpath / "experiments" / "theta_i.toml")
    assert list(config.axes) == ["jump", "theta_i"]
    exponents = [-0.5, -1, -1.5, -2, -2.5, -3, -3.5, -6, -12, -25]
    np.testing.assert_allclose(np.log10(config.axes["theta_i"]), exponents)
    assert config.axes["jump"] == ("same_tau", "own_tau")
    assert (config.fixed["theta_tau"], config.fixed["sigma"], config.repeats) == (0.05, 0.1, 3)
    assert not config.fixed["dithering"]


def test_every_shipped_experiment_can_be_read(request):
    paths = list((request.config.rootpath / "experiments").glob("*.toml"))
    assert paths
    for path in paths:
        assert len(runs_of(load_config(path))) > 0


def test_a_factor_is_one_value_or_an_axis_in_the_files_order(tmp_path):
    config = load_config(
        write(
            tmp_path,
            """
            sigma = 0.2
            battery = 1
            [axis]
            sensor_noise = {linspace = [0, 2, 5]}
            dithering = [true, false]
            theta_i.logspace = [-1, -3, 3]
            """,
        )
    )
    assert list(config.axes.items()) == [
        ("sensor_noise", (0.0, 0.5, 1.0, 1.5, 2.0)),
        ("dithering", (True, False)),
        ("theta_i", (0.1, 0.01, 0.001)),
    ]
    given = {name: value for name, value in config.fixed.items() if value is not None}
    assert given == {
        "theta_tau": 0.05, "sigma": 0.2, "jump": "own_tau", "motor_unit": 0.01, "battery": 1.0,
        "track_bias": 0.12, "placing": 0.01, "heading": 0.1, "cube_turn": 0.1, "push": 0.0,
        "taught": "alike", "controller": "filter", "start": "first", "last_steps": 10,
    }  # fmt: skip
    runs = runs_of(config)
    assert len(runs) == 5 * 2 * 3 * 5 * 3  # … × positions × repeats
    assert set(runs.values) == set(FACTORS)
    first = {name: values[0] for name, values in runs.values.items()}
    assert first == config.fixed | {"sensor_noise": 0.0, "dithering": True, "theta_i": 0.1}
    np.testing.assert_array_equal(runs.repeat[:4], [0, 1, 2, 0])
    np.testing.assert_array_equal(runs.position[:16:3], [0, 1, 2, 3, 4, 0])
    np.testing.assert_array_equal(runs.values["theta_i"][:46:15], [0.1, 0.01, 0.001, 0.1])


def test_axes_that_are_zipped_move_together(tmp_path):
    config = load_config(write(tmp_path, VARIED))
    assert config.dims == {
        "motor_unit": ("motor_unit", "sigma_camera"),
        "jump": ("jump",),
        "records": ("records",),
        "sigma_proximeter_2": ("sigma_proximeter_2",),
    }
    runs = runs_of(config)
    assert len(runs) == 2 * 2 * 2 * 6 * 2
    pairs = set(zip(runs.values["motor_unit"], runs.values["sigma_camera"], strict=True))
    assert pairs == {(0.005, 0.1), (0.01, 0.3)}
    still = ["axis.sigma_camera=[0.1, 0.1]"]
    assert load_config(write(tmp_path, VARIED), still).axes["sigma_camera"] == (0.1, 0.1)
    with pytest.raises(
        ConfigError, match=r"axis\.motor_unit, axis\.sigma_camera contains a value tw"
    ):
        load_config(write(tmp_path, VARIED), [*still, "axis.motor_unit=[0.01, 0.01]"])


def test_what_set_says_takes_the_place_of_what_the_file_says(tmp_path):
    file = write(tmp_path, "theta_i = 0.1\n[axis]\nsigma = {linspace = [0.1, 0.2, 3]}")
    changes = """axis.theta_i.logspace=[-1, -2, 2]; sigma=0.3; jump=own_tau; slots = 7
        positions.x=[0.3]; positions.y.linspace=[0, 0.1, 2]""".replace("\n", ";").split(";")
    config = load_config(file, changes)
    assert config.axes == {"theta_i": (0.1, 0.01)}
    assert (config.fixed["sigma"], config.fixed["jump"]) == (0.3, "own_tau")
    assert config.positions == ((0.3, 0.0), (0.3, 0.1))
    assert config.slots == 7
    spaced = load_config(file, ["axis.sigma.logspace=[-1, 0, 2]"])
    assert spaced.axes == {"sigma": (0.1, 1.0)}


@pytest.mark.parametrize("light", ["", "light = true\n"])
def test_an_axis_of_sigma_without_effect_is_refused(tmp_path, light):
    file = write(tmp_path, light + SMALL + "sigma = [0.1, 0.2]\nsigma_proximeters = [0.1, 0.2]\n")
    load_config(file)
    tuned = write(tmp_path, TUNED, "tuned.toml")
    name = "sigma_proximeters" if light else "sigma"  # which is the light's, if there is one
    with (
        pytest.warns(UserWarning, match=r"takes the place of axis\.theta_i"),
        pytest.raises(ConfigError, match=rf"axis\.{name} has no effect: each of its sensors"),
    ):
        load_config(file, params=tuned)
