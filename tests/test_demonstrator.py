import numpy as np
import pytest
from plane_helpers import EXACT, UNIT

from jaxreplay.plane.demonstrator import DEMONSTRATED, SPANNING, TESTED, facing, record
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams


@pytest.mark.parametrize("seed", [2012, 5])
def test_all_demonstrations_succeed_closely_and_differ(seed):
    records, errors = record(PlaneParams(), DEMONSTRATED, seed)
    assert records.n_records == len(errors) == 20
    assert 1e3 * np.median(errors) <= 3
    lengths = np.asarray(records.lengths)
    assert len(set(lengths)) > 10
    assert 40 < records.period * lengths.mean() < 120
    assert (records.sensor_names, records.command_names) == (SENSOR_NAMES, COMMAND_NAMES)
    sensors, commands = (np.concatenate(rows) for rows in records.sequences())
    assert np.abs(sensors).max() <= 1
    units = commands[:, :2] / UNIT
    np.testing.assert_allclose(units, np.rint(units), atol=1e-5)
    assert 1 < np.abs(units).max() * UNIT / UNIT < EXACT.top_speed / UNIT


def test_a_demonstration_is_the_same_whichever_stand_beside_it_and_however_often():
    three, errors = record(PlaneParams(), DEMONSTRATED[:3], 8)
    two, _ = record(PlaneParams(), DEMONSTRATED[:2], 8)
    for some, more in zip(two.sequences(), three.sequences(), strict=True):
        for one, other in zip(some, more[:2], strict=True):
            np.testing.assert_array_equal(one, other)
    again, same = record(PlaneParams(), DEMONSTRATED[:3], 8)
    np.testing.assert_array_equal(errors, same)
    np.testing.assert_array_equal(three.commands, again.commands)


def test_a_demonstration_that_fails_is_told_with_its_place():
    with pytest.raises(RuntimeError, match=r"the cube at \(0\.300, 0\.050\) m failed"):
        record(PlaneParams(time_limit=20.0), [(0.3, 0.05)], 0)


def test_test_positions_lie_strictly_between_the_demonstrated_ones():
    assert not {tuple(p) for p in TESTED} & {tuple(p) for p in DEMONSTRATED}
    for positions in (DEMONSTRATED, DEMONSTRATED[list(SPANNING)]):
        assert (positions.min(axis=0) < TESTED).all()
        assert (positions.max(axis=0) > TESTED).all()


def test_cubes_are_laid_with_a_face_towards_the_start():
    np.testing.assert_allclose(facing([(0.3, 0.3), (0.2, 0)]), [(0.3, 0.3, np.pi / 4), (0.2, 0, 0)])
