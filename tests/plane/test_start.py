import numpy as np
import pytest
from plane_helpers import AWAY, EXACT, HIGH, PERIOD, plane_with, send

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.params import PlaneParams

N = 400


def test_unequal_tracks_drive_an_arc():
    """Of speeds v_l and v_r: at the rate (v_r − v_l) / separation, round a circle."""
    env = plane_with(*[AWAY] * 20, params=EXACT, track_bias=0.1)
    gain = env._gain
    assert (np.abs(gain - 1) <= 0.1).all()
    assert np.ptp(gain) > 0.1
    send(env, [0.05, 0.05, HIGH, 0, 0], 4.0)
    forward = 0.05 * gain.mean(axis=1)
    rate = 0.05 * (gain[:, 1] - gain[:, 0]) / EXACT.track_separation
    angle = rate * (4.0 - PERIOD / EXACT.substeps)  # a new velocity acts one substep late
    np.testing.assert_allclose(env.pose.robot[:, 2], angle, atol=1e-6)
    chord = 2 * forward / rate * np.sin(angle / 2)
    expected = chord[:, None] * np.stack([np.cos(angle / 2), np.sin(angle / 2)], axis=1)
    # Within a step the tracks move straight on.
    np.testing.assert_allclose(env.pose.robot[:, :2], expected, atol=3e-4)


def test_robot_and_cube_are_put_down_anywhere_within_their_errors():
    limits = {"placing": 0.02, "heading": 0.2, "cube_turn": 0.1}
    env = plane_with(*[(0.3, 0.1, 0.5)] * N, params=EXACT, **limits)
    np.testing.assert_array_equal(env.pose.cube[:, :2], [[0.3, 0.1]] * N)
    off = np.column_stack([env.pose.robot, env.pose.cube[:, 2] - 0.5])
    most = np.array([0.02, 0.02, 0.2, 0.1])
    assert (np.abs(off) <= most).all()
    np.testing.assert_allclose(off.mean(axis=0), 0, atol=4 * most.max() / np.sqrt(3 * N))
    np.testing.assert_allclose(off.std(axis=0), most / np.sqrt(3), rtol=0.12)
    correlation = np.corrcoef(off.T) - np.eye(4)
    assert np.abs(correlation).max() < 4 / np.sqrt(N)


@pytest.mark.parametrize("name", ["track_bias", "placing", "heading", "cube_turn", "push"])
def test_a_world_with_another_setting_differs_in_that_alone(name):
    settings = {"track_bias": 0.1, "placing": 0.01, "heading": 0.1, "cube_turn": 0.1, "push": 0.1}
    worlds = [
        plane_with(*[AWAY] * 5, params=PlaneParams(), **settings | {name: value})
        for value in (settings[name], settings[name] / 2, 0.0)
    ]
    full, half, none = (
        {
            "track_bias": w._gain - 1,
            "placing": w.pose.robot[:, :2],
            "heading": w.pose.robot[:, 2],
            "cube_turn": w.pose.cube[:, 2] - AWAY[2],
            "push": w._push[:, :2],
        }
        for w in worlds
    )
    for other in settings:
        if other == name:
            np.testing.assert_allclose(half[other], full[other] / 2, rtol=1e-9)
            np.testing.assert_array_equal(none[other], 0)
        else:
            np.testing.assert_array_equal(half[other], full[other])
    assert (full[name] != 0).all()


def test_what_differs_follows_from_the_worlds_seed():
    def drawn(seeds):
        env = PlaneVectorEnv(len(seeds), PlaneParams())
        env.reset(seed=seeds, options={"cube": np.tile(AWAY, (len(seeds), 1))})
        return np.hstack([env._gain, env.pose.robot, env._push, env.pose.cube])

    three, one = drawn([7, 8, 9]), drawn([8])
    np.testing.assert_array_equal(three[1], one[0])
    assert (np.ptp(three[:, [0, 1, 2, 3, 4, 7]], axis=0) > 0).all()


def test_a_push_moves_each_track_once_by_up_to_its_distance():
    env = plane_with(*[AWAY] * 20, params=EXACT, push=0.05)
    turned, ahead = [], []
    for _ in range(420):
        send(env, [0, 0, HIGH, 0, 0], PERIOD)
        turned.append(env.pose.robot[:, 2].copy())
        ahead.append(np.hypot(*env.pose.robot[:, :2].T))
    left, right = env._push[:, :2].T  # a push takes a second
    assert (np.abs(env._push[:, :2]) <= 0.05).all()
    np.testing.assert_allclose(turned[-1], (right - left) / EXACT.track_separation, atol=1e-6)
    np.testing.assert_allclose(ahead[-1], np.abs(left + right) / 2, rtol=0.02)
    begins = PERIOD * np.argmax(np.abs(turned) > 1e-9, axis=0)
    np.testing.assert_allclose(begins, env._push[:, 2], atol=2 * PERIOD)
    assert 0 <= begins.min() < 10 < 30 < begins.max() <= 40
