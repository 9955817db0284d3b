from dataclasses import replace

import numpy as np
import pytest
from plane_helpers import EXACT, HIGH, LOW, PERIOD, SCAN, plane_with, pose_of, send

from jaxreplay.plane.actuators import magnet_to_face
from jaxreplay.plane.params import GRAVITY

# A gripper so narrow that it is in no cube's way, however they are turned.
NARROW = replace(EXACT, gripper_width=0.002)
GAP = EXACT.magnet_gap / 2


def before_magnet(lateral=0.0, angle=0.0, gap=GAP):
    """A cube with a face this far ahead of the magnet, moved to the right, turned to the left."""
    ahead = np.array([np.cos(angle), np.sin(angle)])
    left = np.array([-ahead[1], ahead[0]])
    centre = [EXACT.reach, 0] + (gap + EXACT.side / 2) * ahead - lateral * left
    return *centre, angle


def lowered(*cubes, params=NARROW):
    """Worlds that begin with the gripper down."""
    env = plane_with(*cubes, params=params)
    env.pose.elevation[:] = LOW
    return env


def grasp(*cubes, params=NARROW, **to_magnet):
    """Worlds in which the magnet was switched on and has attached the cube."""
    env = lowered(*(cubes or [before_magnet(**to_magnet)]), params=params)
    send(env, [0, 0, LOW, 0, 1], 1)
    return env


def lift(env):
    return send(env, [0, 0, HIGH, 0, 1], 4)


def test_the_magnet_finds_the_face_turned_to_it():
    gap, lateral, angle = magnet_to_face(EXACT, pose_of(cube=(0.2, 0.01, 0.1 + np.pi / 2)))
    magnet = np.array([EXACT.reach, 0])
    out = -np.array([np.cos(0.1), np.sin(0.1)])
    face = np.array([0.2, 0.01]) + out * EXACT.side / 2
    assert gap[0] == pytest.approx((magnet - face) @ out)
    assert abs(lateral[0]) == pytest.approx(abs((magnet - face) @ [-out[1], out[0]]))
    assert angle[0] == pytest.approx(-0.1)


def test_a_good_grasp_holds_lifts_carries_and_releases():
    env = plane_with((0.2, 0.004, 0))
    send(env, [0, 0, LOW, 0, 1], 4)
    *_, info = send(env, [0.01, 0.01, LOW, 0, 1], 4)
    assert env.held[0]
    assert info["alignment_error"][0] == pytest.approx(0.004, abs=1e-6)
    lift(env)
    before = env.pose.cube[0, :2].copy()
    send(env, [-0.02, -0.02, HIGH, 0, 1], 3)
    np.testing.assert_allclose(env.pose.cube[0, :2], before - [0.06, 0], atol=1e-3)
    *_, info = send(env, [-0.02, -0.02, HIGH, 0, 0], 3)
    assert not env.held[0]
    np.testing.assert_allclose(env.pose.cube[0, :2], before - [0.06, 0], atol=2e-3)
    assert info["alignment_error"][0] == pytest.approx(0.004, abs=1e-6)  # of what it last held


def test_success_and_reward_are_for_a_cube_held_and_lifted():
    env = grasp(lateral=0.003)
    lifted = []
    for height, on in ((LOW, 1), (LOW + EXACT.lift - 0.001, 1), (LOW + EXACT.lift, 1), (HIGH, 1),
                       (HIGH, 0), (HIGH, 1)):  # fmt: skip
        _, reward, terminated, _, info = send(env, [0, 0, height, 0, on], 4)
        assert reward[0] == info["is_success"][0]
        assert not terminated[0]
        lifted.append(bool(info["is_success"][0]))
    assert lifted == [False, False, True, True, False, False]


@pytest.mark.parametrize(
    ("lateral", "angle", "gap", "tilt", "on", "height"),
    [
        (0.0, 0.0, GAP, 0.0, 0, LOW),  # off
        (0.0, 0.0, GAP, SCAN, 1, LOW),  # it looks down
        (0.0, 0.0, GAP, 0.0, 1, 0.07),  # over the cube's middle
        (0.0, 0.0, EXACT.magnet_gap + 1e-4, 0.0, 1, LOW),  # too far away
        (EXACT.magnet_offset + 1e-4, 0.0, GAP, 0.0, 1, LOW),  # too far aside
        (-EXACT.magnet_offset - 1e-4, 0.0, GAP, 0.0, 1, LOW),
        (0.0, EXACT.magnet_angle + 1e-3, GAP, 0.0, 1, LOW),  # turned
        (0.0, -EXACT.magnet_angle - 1e-3, GAP, 0.0, 1, LOW),
    ],
)
def test_a_bad_grasp_holds_nothing(lateral, angle, gap, tilt, on, height):
    env = lowered(before_magnet(lateral, angle, gap))
    send(env, [0, 0, height, tilt, 0], 4)
    *_, info = send(env, [0, 0, height, tilt, on], 1)
    assert not env.held[0]
    assert np.isnan(info["alignment_error"][0])


@pytest.mark.parametrize("lateral", [0.0, 0.006, -0.006])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99, -0.5, -0.99])
def test_a_grasped_face_is_drawn_flush_where_it_is(lateral, share):
    env = grasp(before_magnet(lateral, share * EXACT.magnet_angle))
    assert env.held[0]
    assert env.alignment_error[0] == pytest.approx(abs(lateral), abs=1e-9)
    *_, info = lift(env)
    assert info["is_success"][0]
    flush = (EXACT.reach + EXACT.side / 2, -lateral, 0)
    np.testing.assert_allclose(env.pose.cube[0], flush, atol=5e-4)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_worst_grasp_that_lifts_is_where_the_magnets_hold_balances_the_weight(sign):
    """A share w of the full hold balances the weight, so that 1 − w of it may be missing."""
    weight = EXACT.cube_mass * GRAVITY * EXACT.side / 2
    share = weight / (EXACT.magnet_force * EXACT.magnet_radius)
    worst = sign * (1 - share) * EXACT.magnet_offset
    env = grasp(before_magnet(0.99 * worst), before_magnet(1.01 * worst))
    assert env.held.all()
    before = env.pose.cube.copy()
    *_, info = lift(env)
    np.testing.assert_array_equal(info["is_success"], [True, False])
    np.testing.assert_array_equal(env.held, [True, False])
    np.testing.assert_allclose(env.pose.cube, before, atol=1e-4)  # one in the air, one below


@pytest.mark.parametrize("lateral", [0.0, 0.004])
def test_the_magnet_drags_what_rubs_the_floor_less_than_it_holds(lateral):
    force = EXACT.magnet_force * (1 - lateral / EXACT.magnet_offset)
    limit = force / (EXACT.floor_friction * GRAVITY)
    for share, dragged in ((0.5, True), (0.93, True), (1.07, False), (2, False)):
        env = grasp(lateral=lateral, params=replace(NARROW, cube_mass=share * limit))
        before = env.pose.cube[0].copy()
        assert env.held[0]
        send(env, [-0.01, -0.01, LOW, 0, 1], 5)
        assert env.held[0] == dragged
        np.testing.assert_allclose(
            env.pose.cube[0], before - [0.05 * dragged, 0, 0], atol=EXACT.magnet_gap
        )


def test_a_magnet_turned_down_releases_the_cube():
    env = grasp()
    send(env, [0, 0, LOW, EXACT.grasping_tilt / 2, 1], 1)
    assert env.held[0]
    send(env, [0, 0, LOW, EXACT.grasping_tilt * 2, 1], 1)
    assert not env.held[0]


def test_a_magnet_switched_off_leaves_the_cube_behind():
    env = grasp(lateral=0.001)
    before = env.pose.cube[0].copy()
    send(env, [-0.01, -0.01, LOW, 0, 0], 3)
    within_the_step = 0.01 * PERIOD + 1e-6
    np.testing.assert_allclose(env.pose.cube[0], before, atol=within_the_step)
