"""Studies of other controllers than the filter."""

import numpy as np
import pytest
from study_helpers import beginnings, by_robot, of_beginnings

from jaxreplay.errors import ConfigError
from jaxreplay.loop.controller import Observed
from jaxreplay.study.again import run_again
from jaxreplay.study.config import StudyConfig, load_config
from jaxreplay.study.run import run_study

pytestmark = pytest.mark.usefixtures("fewer_windows")


class Still:
    """A controller of somebody's own: it stands still and ends after 30 steps."""

    def __init__(self, records, params, options):
        self.command = np.zeros((len(params.theta_i), records.n_commands))
        self.steps = np.zeros(len(params.theta_i), int)

    def begin(self, which, params):
        self.steps[which] = 0

    def observe(self, z, which):
        self.steps[which] += 1
        return Observed((self.steps == 30).astype(float))


TEXT = """
seed = 4
repeats = 1
theta_i = 0.01
positions = [[0.3, 0.0], [0.35, 0.05]]
[axis]
controller = ["filter", "tape", "test_controllers:Still"]
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("controllers")
    config = load_config(of_beginnings(folder, TEXT))
    return config, run_study(config, folder)


def test_each_controller_ends_its_runs_by_its_own_rule(study):
    _, dataset = study
    assert (dataset.outcome == "Fg").all()  # demonstrations end before the grasp
    assert (dataset.lifted == 0).all()
    lengths = np.asarray(beginnings().lengths)
    np.testing.assert_allclose(dataset.duration.sel(controller="tape"), 0.1 * lengths[0])
    np.testing.assert_allclose(dataset.duration.isel(controller=2), 3.0)
    has_evidence = np.isfinite(dataset.log_evidence).all(["position", "repeat"]).values
    assert has_evidence.tolist() == [True, False, False]
    audited = np.isfinite(dataset.command_error).any(["position", "repeat"]).values
    assert audited.tolist() == [True, False, False]


def test_controllers_meet_the_same_worlds(study):
    config, _ = study
    robots = by_robot(config, beginnings())
    filtered, taped = (run_again(config, robots, k) for k in (0, 2))
    rest = slice(0, 5)  # both stand still at first
    np.testing.assert_array_equal(filtered.observations[rest], taped.observations[rest])
    np.testing.assert_array_equal(filtered.scene.cube[0], taped.scene.cube[0])
    assert taped.values["controller"] == "tape"
    assert taped.beliefs.shape[0] == len(taped.commands)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tabe", "no controller tabe; did you mean tape"),
        ("nowhere:Mine", "No module named 'nowhere'"),
        ("test_controllers:Mine", "test_controllers does not contain Mine"),
        (3, "controller must be a controller's name; got 3"),
    ],
)
def test_a_controller_that_is_not_there_is_one_line_before_any_work(name, message):
    with pytest.raises(ConfigError, match=message) as error:
        StudyConfig({"theta_i": [0.1]}, {"controller": name})
    assert "\n" not in str(error.value)
