import numpy as np
import pytest
from plane_helpers import EXACT, PERIOD

from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED, TESTED, facing
from jaxreplay.plane.teacher import demonstrate

SIX = [0, 4, 7, 12, 15, 19]  # demonstrated positions that experiments/interpolation.toml replays


@pytest.mark.parametrize("seed", [2012, 5])
def test_all_demonstrations_succeed_closely_and_differ(seed):
    made = demonstrate(PlaneParams(), DEMONSTRATED, seed)
    assert len(made.sensors) == len(made.commands) == len(made.alignment_error) == 20
    assert 1e3 * np.median(made.alignment_error) <= 3
    lengths = np.array([len(rows) for rows in made.sensors])
    assert lengths.tolist() == [len(rows) for rows in made.commands]
    assert len(set(lengths)) > 10
    assert 40 < PERIOD * lengths.mean() < 120
    sensors, commands = np.concatenate(made.sensors), np.concatenate(made.commands)
    assert (sensors.shape[1], commands.shape[1]) == (len(SENSOR_NAMES), len(COMMAND_NAMES))
    assert np.abs(sensors).max() <= 1
    unit = PlaneParams().motor_unit
    units = commands[:, :2] / unit
    np.testing.assert_allclose(units, np.rint(units), atol=1e-5)
    assert 1 < np.abs(units).max() < EXACT.top_speed / unit


def test_a_demonstration_does_not_depend_on_the_others_and_is_repeatable():
    three, two, again = (demonstrate(PlaneParams(), DEMONSTRATED[:n], 8) for n in (3, 2, 3))
    for some, more, same in zip(two[:2], three[:2], again[:2], strict=True):
        for one, other in zip(some, more[:2], strict=True):
            np.testing.assert_array_equal(one, other)
        for one, other in zip(more, same, strict=True):
            np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(three.alignment_error, again.alignment_error)
    np.testing.assert_array_equal(three.alignment_error[:2], two.alignment_error)


def test_a_demonstration_that_fails_is_an_error_that_names_its_place():
    with pytest.raises(RuntimeError, match=r"the cube at \(0\.300, 0\.050\) m failed"):
        demonstrate(PlaneParams(time_limit=20.0), np.array([(0.3, 0.05)]), 0)


def test_test_positions_lie_strictly_between_the_demonstrated_ones():
    assert not {tuple(p) for p in TESTED} & {tuple(p) for p in DEMONSTRATED}
    for positions in (DEMONSTRATED, DEMONSTRATED[SIX]):
        assert (positions.min(axis=0) < TESTED).all()
        assert (positions.max(axis=0) > TESTED).all()


def test_cubes_are_laid_with_a_face_towards_the_start():
    np.testing.assert_allclose(facing([(0.3, 0.3), (0.2, 0)]), [(0.3, 0.3, np.pi / 4), (0.2, 0, 0)])
