from dataclasses import replace

import numpy as np
import pytest
from plane_helpers import AWAY, EXACT, HIGH, LOW, PERIOD, SCAN, SUBSTEP, plane_with, send

from jaxreplay.plane.params import GRAVITY
from jaxreplay.plane.world import World

FINE = replace(EXACT, substeps=200)


def test_it_drives_straight_at_the_commanded_speed():
    env = plane_with(AWAY)
    send(env, [0.05, 0.05, HIGH, 0, 0], 2)
    np.testing.assert_allclose(env.pose.robot[0], [0.05 * (2 - SUBSTEP), 0, 0], atol=1e-6)


def test_it_turns_at_the_rate_of_a_differential_drive():
    env = plane_with(AWAY)
    send(env, [-0.015, 0.015, HIGH, 0, 0], 2)
    rate = 0.03 / EXACT.track_separation
    np.testing.assert_allclose(env.pose.robot[0], [0, 0, rate * (2 - SUBSTEP)], atol=1e-6)


def test_tracks_at_two_speeds_drive_an_arc_whose_radius_is_the_differential_drives():
    env = plane_with(AWAY)
    radius = EXACT.track_separation / 2 * (0.05 + 0.03) / (0.05 - 0.03)
    for _ in range(8):
        send(env, [0.03, 0.05, HIGH, 0, 0], 1)
        x, y, heading = env.pose.robot[0]
        assert np.hypot(x, y - radius) == pytest.approx(radius, abs=0.04 * SUBSTEP)
        assert np.arctan2(x, radius - y) == pytest.approx(heading, abs=0.04 * SUBSTEP / radius)
    assert heading == pytest.approx(0.02 / EXACT.track_separation * (8 - SUBSTEP))


@pytest.mark.parametrize("traction", [0.06, 0.12])
def test_it_brakes_as_hard_as_its_tracks_grip(traction):
    world = World(replace(FINE, traction=traction), AWAY)
    for _ in range(100):
        world.advance(0.3, 0, 0)
    before = world.robot.position.x
    for _ in range(100):
        world.advance(0, 0, 0)
    assert world.robot.velocity.x == pytest.approx(0, abs=1e-9)
    way = 0.3**2 / (2 * traction * GRAVITY)
    assert world.robot.position.x - before == pytest.approx(way, abs=0.3 * PERIOD / FINE.substeps)


@pytest.mark.parametrize(
    ("direction", "within"),
    [(0, 0.01), (np.pi / 2, 0.01), (np.pi / 4, 0.06), (np.pi / 8, 0.06)],
)
def test_a_cube_set_sliding_goes_as_far_as_friction_allows(direction, within):
    """Square to a face as a single point would, askew nearly so."""
    world = World(FINE, AWAY)
    world.cube.velocity = 0.3 * np.cos(direction), 0.3 * np.sin(direction)
    for _ in range(10):
        *_, x, y, angle = world.advance(0, 0, 0)
    slid = np.array([x, y]) - AWAY[:2]
    way = 0.3**2 / (2 * EXACT.floor_friction * GRAVITY)
    late = 0.3 * PERIOD / FINE.substeps
    assert np.hypot(*slid) == pytest.approx(way, rel=within, abs=late)
    assert np.arctan2(*slid[::-1]) == pytest.approx(direction, abs=0.03)
    assert angle == pytest.approx(0, abs=0.01)


def test_a_cube_set_spinning_slows_down_at_the_rate_of_frictions_torque():
    """μ m g over its face, whose points are 0.3826 sides from its centre in the mean."""
    world = World(FINE, AWAY)
    world.cube.angular_velocity = 20
    friction = 0.3826 * EXACT.side * EXACT.floor_friction * GRAVITY * EXACT.cube_mass
    rate = friction / (EXACT.cube_mass * EXACT.side**2 / 6)
    world.advance(0, 0, 0)
    assert world.cube.angular_velocity == pytest.approx(20 - rate * PERIOD, rel=1e-3)
    world.advance(0, 0, 0)
    assert world.cube.angle == pytest.approx(20**2 / (2 * rate), rel=0.01)
    np.testing.assert_allclose(world.cube.position, AWAY[:2], atol=1e-6)


def test_the_mean_lever_of_a_square_is_the_one_used():
    n = 1000
    across = (np.arange(n) + 0.5) / n - 0.5
    assert np.hypot(across[:, None], across).mean() == pytest.approx(0.3826, abs=5e-5)


def test_a_straight_push_moves_the_cube_straight_and_it_stops_with_the_robot():
    env = plane_with((0.2, 0, 0))
    send(env, [0, 0, LOW, SCAN, 0], 4)
    send(env, [0.02, 0.02, LOW, SCAN, 0], 5)
    touching = env.pose.robot[0, 0] + EXACT.reach + EXACT.side / 2
    np.testing.assert_allclose(env.pose.cube[0], [touching, 0, 0], atol=2e-3)
    pushed = env.pose.cube[0].copy()
    send(env, [0, 0, LOW, SCAN, 0], 2)
    np.testing.assert_allclose(env.pose.cube[0], pushed, atol=0.02 * SUBSTEP + 1e-5)


@pytest.mark.parametrize("side", [1, -1])
def test_an_off_centre_push_turns_the_cube_away_until_it_slides_off(side):
    env = plane_with((0.2, side * 0.045, 0))
    send(env, [0, 0, LOW, SCAN, 0], 4)
    send(env, [0.02, 0.02, LOW, SCAN, 0], 4)
    x, y, angle = env.pose.cube[0] * [1, side, side]
    assert angle > 0.1  # pushed on its right side it turns left
    send(env, [0.02, 0.02, LOW, SCAN, 0], 12)
    x, y, _ = env.pose.cube[0] * [1, side, 1]
    assert x - env.pose.robot[0, 0] < EXACT.reach  # it fell behind the gripper's end,
    assert y > EXACT.gripper_width / 2 + EXACT.side / 2 - 1e-3  # beside the gripper


@pytest.mark.parametrize(("share", "moves"), [(0.5, 1), (0.95, 1), (1.1, 0), (2, 0)])
def test_tracks_slip_when_the_cube_resists_more_than_they_grip(share, moves):
    most = EXACT.mass * EXACT.traction / EXACT.floor_friction
    env = plane_with((0.2, 0, 0), params=replace(EXACT, cube_mass=share * most))
    send(env, [0, 0, LOW, SCAN, 0], 4)
    send(env, [0.05, 0.05, LOW, SCAN, 0], 2)
    before = env.pose.robot[0, 0]
    send(env, [0.05, 0.05, LOW, SCAN, 0], 2)
    assert env.pose.robot[0, 0] - before == pytest.approx(moves * 0.05 * 2, abs=1e-3)


def test_a_raised_gripper_passes_over_the_cube_and_the_hull_pushes_it():
    env = plane_with((0.2, 0, 0))
    send(env, [0.02, 0.02, HIGH, 0, 0], 4)
    np.testing.assert_array_equal(env.pose.cube[0], [0.2, 0, 0])
    send(env, [0.02, 0.02, HIGH, 0, 0], 4)
    touching = env.pose.robot[0, 0] + EXACT.hull_radius + EXACT.side / 2
    np.testing.assert_allclose(env.pose.cube[0], [touching, 0, 0], atol=2e-3)
