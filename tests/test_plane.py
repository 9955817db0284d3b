from dataclasses import replace

import numpy as np
import pymunk
import pytest

from jaxreplay.plane.demonstrator import DEMONSTRATED, SPANNING, TESTED, facing, record
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.sensors import PlaneState, camera, magnet_to_face, proximeters, ray_to_square
from jaxreplay.plane.world import Plane

EXACT = PlaneParams(wheel_noise=0.0, camera_noise=0.0, proximeter_noise=0.0)
SUBSTEP = EXACT.control_period / EXACT.substeps  # a new velocity acts one substep late
HIGH, LOW, SCAN = EXACT.high, EXACT.low, EXACT.scanning_tilt


def plane_with(*cubes, params=EXACT):
    return Plane(params, np.array(cubes, dtype=float), [(0, b) for b in range(len(cubes))])


def send(plane, command, seconds):
    n = len(plane.state.robot)
    for _ in range(round(seconds / plane.params.control_period)):
        seen = plane.step(np.tile(command, (n, 1)), np.ones(n, dtype=bool))
    return seen


def state_of(robot=(0, 0, 0), cube=(0.3, 0, 0), elevation=LOW, tilt=SCAN):
    return PlaneState(
        *(np.array([v], dtype=float) for v in (robot, cube, elevation, tilt)), [False]
    )


def test_it_drives_straight_at_the_commanded_speed():
    plane = plane_with((0.6, 0.3, 0))
    send(plane, [10, 10, HIGH, 0, 0], 2)
    speed = 10 * EXACT.motor_unit
    np.testing.assert_allclose(plane.state.robot[0], [speed * (2 - SUBSTEP), 0, 0], atol=1e-6)


def test_it_turns_at_the_rate_of_a_differential_drive():
    plane = plane_with((0.6, 0.3, 0))
    send(plane, [-3, 3, HIGH, 0, 0], 2)
    rate = 6 * EXACT.motor_unit / EXACT.track_separation
    np.testing.assert_allclose(plane.state.robot[0], [0, 0, rate * (2 - SUBSTEP)], atol=1e-6)


def test_track_commands_are_rounded_to_whole_units():
    plane = plane_with((0.6, 0.3, 0))
    send(plane, [0.4, 0.49, HIGH, 0, 0], 5)
    np.testing.assert_array_equal(plane.state.robot[0], 0)
    send(plane, [0.6, 0.6, HIGH, 0, 0], 2)
    assert plane.state.robot[0, 0] == pytest.approx(EXACT.motor_unit * (2 - SUBSTEP), rel=1e-4)


def test_wheel_noise_stays_within_its_share():
    plane = plane_with(*[(0.6, 0.3, 0)] * 20, params=PlaneParams())
    send(plane, [10, 10, HIGH, 0, 0], 1)
    way = plane.state.robot[:, 0]
    assert way.std() > 0
    expected = 10 * EXACT.motor_unit * (1 - SUBSTEP)
    np.testing.assert_allclose(way, expected, rtol=PlaneParams().wheel_noise)


def test_servos_move_at_their_speed_and_stop_at_the_set_point_or_the_limit():
    plane = plane_with((0.6, 0.3, 0))
    send(plane, [0, 0, LOW, 0.5, 0], 1)
    assert plane.state.elevation[0] == pytest.approx(HIGH - EXACT.elevation_speed)
    assert plane.state.tilt[0] == pytest.approx(0.5)
    send(plane, [0, 0, -1, 9, 0], 5)
    assert (plane.state.elevation[0], plane.state.tilt[0]) == pytest.approx((LOW, SCAN))


def test_a_straight_push_moves_the_cube_straight_and_it_stops_with_the_robot():
    plane = plane_with((0.2, 0, 0))
    send(plane, [0, 0, LOW, SCAN, 0], 4)
    send(plane, [4, 4, LOW, SCAN, 0], 5)
    touching = plane.state.robot[0, 0] + EXACT.reach + EXACT.side / 2
    np.testing.assert_allclose(plane.state.cube[0], [touching, 0, 0], atol=2e-3)
    pushed = plane.state.cube[0].copy()
    send(plane, [0, 0, LOW, SCAN, 0], 2)
    np.testing.assert_allclose(plane.state.cube[0], pushed, atol=4e-4)  # 0.02 s at 2 cm/s


@pytest.mark.parametrize("side", [1, -1])
def test_an_off_centre_push_turns_the_cube_away_from_the_pushed_side(side):
    plane = plane_with((0.2, side * 0.045, 0))
    send(plane, [0, 0, LOW, SCAN, 0], 4)
    send(plane, [4, 4, LOW, SCAN, 0], 4)
    assert side * plane.state.cube[0, 2] > 0.1  # pushed on its right side it turns left


def test_a_raised_gripper_passes_over_the_cube():
    plane = plane_with((0.2, 0, 0))
    send(plane, [2, 2, HIGH, 0, 0], 4)
    np.testing.assert_array_equal(plane.state.cube[0], [0.2, 0, 0])


def grasp(cube, tilt=0.0, on=1):
    plane = plane_with(cube)
    send(plane, [0, 0, LOW, tilt, on], 4)
    send(plane, [2, 2, LOW, tilt, on], (cube[0] - EXACT.reach - EXACT.side / 2) / 0.01 + 1)
    return plane


def test_a_good_grasp_holds_lifts_carries_and_lets_go():
    plane = grasp((0.2, 0.004, 0))
    assert plane.state.held[0]
    assert plane.alignment_error[0] == pytest.approx(0.004, abs=1e-4)
    assert not plane.lifted[0]
    send(plane, [0, 0, HIGH, 0, 1], 4)
    assert plane.lifted[0]
    before = plane.state.cube[0, :2].copy()
    send(plane, [-4, -4, HIGH, 0, 1], 3)
    np.testing.assert_allclose(plane.state.cube[0, :2], before - [0.06, 0], atol=1e-3)
    send(plane, [-4, -4, HIGH, 0, 0], 3)
    np.testing.assert_allclose(plane.state.cube[0, :2], before - [0.06, 0], atol=2e-3)
    assert not plane.lifted[0]


@pytest.mark.parametrize(
    ("cube", "tilt", "on"),
    [
        ((0.2, 0.02, 0), 0.0, 1),  # too far aside
        ((0.2, 0, 0), SCAN, 1),  # turned away
        ((0.2, 0, 0), 0.0, 0),  # off
        ((0.25, 0, np.pi / 4), 0.0, 1),  # at an edge, seen before it is pushed square
    ],
)
def test_a_bad_grasp_holds_nothing(cube, tilt, on):
    plane = plane_with(cube)
    send(plane, [0, 0, LOW, tilt, on], 4)
    gap = cube[0] - EXACT.reach - EXACT.side / 2 * (2**0.5 if cube[2] else 1)
    send(plane, [2, 2, LOW, tilt, on], gap / 0.01 + 0.3)
    assert not plane.state.held[0]
    assert np.isnan(plane.alignment_error[0])


def test_the_hull_crossing_the_border_is_outside():
    plane = plane_with((0.3, 0, 0))
    send(plane, [-20, -20, HIGH, 0, 0], 1.6)
    assert not plane.outside[0]
    send(plane, [-20, -20, HIGH, 0, 0], 0.2)
    assert plane.outside[0]


def test_the_camera_is_a_pinhole_that_remembers_the_side():
    half = np.tan(EXACT.field_of_view / 2)
    at = np.array([[0.3, -0.1, 0], [0.3, 0.1, 0], [0.1, 0.2, 0], [-0.3, 0, 0]])
    n = len(at)
    state = PlaneState(np.zeros((n, 3)), at, np.full(n, LOW), np.zeros(n), np.zeros(n, bool))
    x = camera(EXACT, state, np.array([0, 0, -1.0, 1.0]))
    np.testing.assert_allclose(x, [1 / 3 / half, -1 / 3 / half, -1, 1])


def test_a_cube_never_seen_reads_zero():
    plane = plane_with((-0.1, 0.2, 0))
    assert plane.observe()[0, 0] == 0


@pytest.mark.parametrize("distance", [0.01, 0.04, 0.08])
def test_scanning_proximeters_read_the_linearised_distance(distance):
    state = state_of(cube=(EXACT.reach + distance + EXACT.side / 2, 0, 0))
    narrow = replace(EXACT, beam_half_angle=0.0)
    middle = proximeters(narrow, state)[0, 1:5]
    np.testing.assert_allclose(middle, 1 - distance / EXACT.proximeter_range, rtol=1e-9)


def test_proximeters_see_nothing_out_of_range_or_tilted_away_or_aside():
    near = (EXACT.reach + 0.03 + EXACT.side / 2, 0, 0)
    assert not proximeters(EXACT, state_of(cube=(0.4, 0, 0))).any()
    assert not proximeters(EXACT, state_of(cube=near, tilt=0.0)).any()
    assert not proximeters(EXACT, state_of(cube=near, elevation=HIGH)).any()
    readings = proximeters(EXACT, state_of(cube=(near[0], 0.05, 0)))[0]
    assert readings[0] > 0.3  # the leftmost sees a cube to the left
    assert readings[-1] == 0


def test_rays_agree_with_pymunk():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(300):
        square = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-4, 4)])
        space = pymunk.Space()
        body = pymunk.Body(body_type=pymunk.Body.STATIC)
        body.position, body.angle = tuple(square[:2]), square[2]
        space.add(body, pymunk.Poly.create_box(body, (0.06, 0.06)))
        space.reindex_static()
        start = rng.uniform(0.15, 0.3, 2) * rng.choice([-1, 1], 2)
        angle = np.arctan2(*(square[:2] - start)[::-1]) + rng.uniform(-0.3, 0.3)
        end = start + np.array([np.cos(angle), np.sin(angle)])
        hit = space.segment_query_first(tuple(start), tuple(end), 0, pymunk.ShapeFilter())
        ours = ray_to_square(*start[:, None, None], np.array([[angle]]), square[None], 0.06)[0, 0]
        theirs = np.inf if hit is None else hit.alpha
        assert ours == pytest.approx(theirs, abs=1e-6)
        hits += hit is not None
    assert 50 < hits < 250


def test_the_magnet_finds_the_face_turned_to_it():
    gap, lateral, angle = magnet_to_face(EXACT, state_of(cube=(0.2, 0.01, 0.1 + np.pi / 2)))
    magnet = np.array([EXACT.reach, 0])
    out = -np.array([np.cos(0.1), np.sin(0.1)])
    face = np.array([0.2, 0.01]) + out * EXACT.side / 2
    assert gap[0] == pytest.approx((magnet - face) @ out)
    assert abs(lateral[0]) == pytest.approx(abs((magnet - face) @ [-out[1], out[0]]))
    assert angle[0] == pytest.approx(-0.1)


def test_a_run_does_not_depend_on_those_beside_it():
    rng = np.random.default_rng(1)
    cubes, keys = facing(TESTED), [(7, b) for b in range(5)]
    commands = rng.uniform([-4, -4, LOW, 0, 0], [9, 9, HIGH, SCAN, 1], (60, 5, 5))
    together = Plane(PlaneParams(), cubes, keys)
    alone = Plane(PlaneParams(), cubes[3:4], keys[3:4])
    for command in commands:
        seen = together.step(command, np.ones(5, bool))
        seen_alone = alone.step(command[3:4], np.ones(1, bool))
        np.testing.assert_array_equal(seen[3:4], seen_alone)
    np.testing.assert_array_equal(together.state.robot[3], alone.state.robot[0])
    np.testing.assert_array_equal(together.state.cube[3], alone.state.cube[0])


def test_a_world_that_has_ended_stands_still():
    plane = plane_with((0.3, 0, 0), (0.3, 0, 0))
    for _ in range(20):
        plane.step(np.tile([5.0, 5.0, LOW, 1, 0], (2, 1)), np.array([True, False]))
    assert plane.state.robot[0, 0] > 0.04
    np.testing.assert_array_equal(plane.state.robot[1], 0)
    assert plane.state.elevation[1] == HIGH


@pytest.mark.parametrize("seed", [2012, 5])
def test_all_demonstrations_succeed_closely_and_differ(seed):
    records, errors = record(PlaneParams(), DEMONSTRATED, seed)
    assert records.n_records == 20
    assert 1e3 * np.median(errors) <= 3
    lengths = np.asarray(records.lengths)
    assert len(set(lengths)) > 10
    assert 40 < records.period * lengths.mean() < 120
    sensors, commands = records.sequences()
    np.testing.assert_array_equal(np.concatenate(commands)[:, :2] % 1, 0)
    assert np.abs(np.concatenate(sensors)).max() <= 1


def test_test_positions_lie_strictly_between_the_demonstrated_ones():
    assert not {tuple(p) for p in TESTED} & {tuple(p) for p in DEMONSTRATED}
    for positions in (DEMONSTRATED, DEMONSTRATED[list(SPANNING)]):
        assert (positions.min(axis=0) < TESTED).all()
        assert (positions.max(axis=0) > TESTED).all()
