import numpy as np
import pytest

from jaxreplay.plane.stall import stall

PERIOD = 0.1
TIMES = PERIOD * np.arange(600)  # 60 s
X, Y, HEADING, ELEVATION, TILT = range(5)


def trail(moves=None, times=TIMES):
    """Poses of base and gripper: at rest, but for the given motions."""
    rest = np.tile([0.1, 0.05, 0.3, 0.12, 0.0], (len(times), 1))
    for column, values in (moves or {}).items():
        rest[:, column] += values
    return rest


def jitter(size, seed=0):
    return np.random.default_rng(seed).uniform(-size / 2, size / 2, len(TIMES))


def test_what_does_not_move_is_fixed():
    assert stall(trail(), PERIOD) == "fixed"


@pytest.mark.parametrize(
    ("coordinate", "size"),
    [(X, 0.005), (Y, 0.005), (HEADING, np.deg2rad(2)), (ELEVATION, 0.005), (TILT, np.deg2rad(2))],
)
def test_base_and_gripper_may_move_by_5_mm_or_2_degrees_and_are_fixed(coordinate, size):
    creep = np.linspace(0, 1, len(TIMES))
    assert stall(trail({coordinate: 0.99 * size * creep}), PERIOD) == "fixed"
    assert stall(trail({coordinate: -1.01 * size * creep}), PERIOD) == "slow"


def test_jitter_as_of_dithering_tracks_is_fixed():
    assert stall(trail({X: jitter(0.004), HEADING: jitter(0.03, 1)}), PERIOD) == "fixed"


@pytest.mark.parametrize("lasts", [1.0, 3.7, 11.0, 29.0])
@pytest.mark.parametrize("shape", [np.sin, lambda phase: np.clip(3 * np.sin(phase), -1, 1)])
def test_what_comes_back_again_and_again_is_cyclic(lasts, shape):
    phase = 2 * np.pi * TIMES / lasts
    assert stall(trail({HEADING: 0.2 * shape(phase)}), PERIOD) == "cyclic"
    assert stall(trail({X: 0.02 * shape(phase), TILT: shape(phase)}), PERIOD) == "cyclic"


def test_a_cycle_with_jitter_is_one_while_the_jitter_is_small():
    cycle = 0.02 * np.sin(2 * np.pi * TIMES / 4)
    assert stall(trail({X: cycle + jitter(0.002)}), PERIOD) == "cyclic"
    assert stall(trail({X: cycle + jitter(0.1)}), PERIOD) == "slow"


def test_what_creeps_is_slow():
    assert stall(trail({X: 0.001 * TIMES}), PERIOD) == "slow"
    assert stall(trail({X: 0.1 * TIMES}), PERIOD) == "slow"
    walk = 0.001 * np.random.default_rng(0).normal(size=len(TIMES)).cumsum()
    assert stall(trail({Y: walk + 0.001 * TIMES}), PERIOD) == "slow"


def test_a_cycle_longer_than_30_s_is_slow():
    assert stall(trail({X: 0.05 * np.sin(2 * np.pi * TIMES / 45)}), PERIOD) == "slow"


def test_a_cycle_that_creeps_on_is_slow():
    """Each turn ends further than it began by more than a quarter of its size."""
    cycle = 0.01 * np.sin(2 * np.pi * TIMES / 5)
    assert stall(trail({X: cycle + 0.0002 * TIMES}), PERIOD) == "cyclic"
    assert stall(trail({X: cycle + 0.004 * TIMES}), PERIOD) == "slow"


def test_a_gripper_that_nods_on_a_robot_that_drives_on_is_slow():
    nods = 0.8 * np.sin(2 * np.pi * TIMES / 4)
    assert stall(trail({TILT: nods}), PERIOD) == "cyclic"
    assert stall(trail({TILT: nods, X: 0.01 * TIMES}), PERIOD) == "slow"


@pytest.mark.parametrize("sign", [1, -1])
def test_a_robot_that_turns_on_the_spot_or_in_a_circle_comes_back(sign):
    """Its heading is counted on and on, yet a whole turn is the same pose."""
    turned = sign * 2 * np.pi * TIMES / 20
    assert stall(trail({HEADING: turned}), PERIOD) == "cyclic"
    circle = {X: 0.1 * np.cos(turned), Y: 0.1 * np.sin(turned), HEADING: turned}
    assert stall(trail(circle), PERIOD) == "cyclic"


@pytest.mark.parametrize("seconds", [0.1, 1.0, 20.0])
def test_a_short_run_is_classified_too(seconds):
    times = TIMES[: round(seconds / PERIOD)]
    assert stall(trail(times=times), PERIOD) == "fixed"
    if seconds > 0.1:
        assert stall(trail({X: 0.1 * times}, times), PERIOD) == "slow"
