import numpy as np
import pytest
from plane_helpers import PERIOD
from study_helpers import by_robot

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.light import Lit, light_level
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED, TESTED, facing
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.demonstrations import record
from jaxreplay.study.runs import records_of, runs_of, shards_of
from jaxreplay.study.shard import replays_of
from jaxreplay.study.worlds.plane import PLANE_FACTORS as FACTORS

pytestmark = pytest.mark.usefixtures("fewer_windows")


def test_worlds_are_as_they_were_but_for_their_light():
    worlds, plain = Lit(PlaneVectorEnv(3)), PlaneVectorEnv(3)
    options = {"cube": facing(TESTED[:3]), "reset_mask": np.ones(3, bool)}
    seen = [env.reset(seed=[4, 5, 6], options=options)[0] for env in (worlds, plain)]
    actions = np.tile([0.02, 0.01, 0.1, 0, 0], (3, 1))
    for _ in range(5):
        np.testing.assert_array_equal(seen[0][:, :7], seen[1])
        seen = [env.step(actions)[0] for env in (worlds, plain)]
    assert worlds.single_observation_space.contains(seen[0][0])
    light = seen[0][:2, 7]
    assert len(set(light)) == 2
    again, _ = worlds.reset(
        seed=[None, None, 4], options=options | {"reset_mask": np.arange(3) > 1}
    )
    np.testing.assert_array_equal(again[:, 7], [*light, light[0]])


def test_worlds_in_light_are_reset_as_others_are():
    worlds = Lit(PlaneVectorEnv(3))
    light = worlds.reset(seed=4)[0][:, 7]
    np.testing.assert_array_equal(light, np.float32([light_level(seed) for seed in (4, 5, 6)]))
    with pytest.raises(ValueError, match="unknown option cub"):
        worlds.reset(seed=7, options={"cub": 0})
    np.testing.assert_array_equal(worlds.reset()[0][:, 7], light)  # without a seed, as it was


def test_light_is_on_average_in_the_middle_and_differs_from_run_to_run():
    worlds = Lit(PlaneVectorEnv(400))
    options = {"cube": facing(TESTED[np.zeros(400, int)]), "reset_mask": np.ones(400, bool)}
    light = worlds.reset(seed=list(range(400)), options=options)[0][:, 7]
    assert ((light >= 0) & (light <= 1)).all()
    assert abs(light.mean() - 0.5) < 4 / np.sqrt(12 * 400)
    assert abs(light.var() - 1 / 12) < 0.02


@pytest.mark.slow
def test_a_run_in_changing_light_is_a_run_of_its_own():
    """The filter observes the light, and such a run has results as any other."""
    records = record(PlaneParams(), DEMONSTRATED[[6, 8]], 3)
    assert (records.sensor_names, records.command_names) == (SENSOR_NAMES, COMMAND_NAMES)
    assert records.period == PERIOD
    fixed = {name: f.default for name, f in FACTORS.items()}
    fixed |= {"theta_i": 0.01, "jump": "own_tau"}
    del fixed["light"]
    config = StudyConfig(
        {"light": (False, True)}, fixed, repeats=1, positions=((0.3, 0.0),), seed=3
    )
    runs = runs_of(config)
    parts = [runs.of(which) for which in shards_of(config, runs, 8)]
    assert [len(part) for part in parts] == [1, 1]
    robots = by_robot(config, records)
    plain, bright = (records_of(config, robots, part) for part in parts)
    assert [plain.n_sensors, bright.n_sensors] == [7, 8]
    for rows, lighted in zip(records.sequences()[0], bright.sequences()[0], strict=True):
        np.testing.assert_array_equal(lighted[:, :7], rows)
        assert np.ptp(lighted[:, 7]) == 0
    lighted = replays_of(config, robots, parts[1])
    assert lighted.ending[0]
    assert lighted.steps[0] > 100
