from dataclasses import replace

import numpy as np
import pymunk
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plane_helpers import EXACT, HIGH, LOW, OLD, SCAN, plane_with, pose_of, send

from jaxreplay.plane.sensors import camera, infrared, linearised, proximeters, ray_to_square

HALF_IMAGE = EXACT.image_width / 2
IN_SIGHT = (0.3, 0.03, 0)


def tangent_view(ahead, left):
    """A pinhole's x of a point."""
    return -left / ahead / np.tan(EXACT.field_of_view / 2)


def seen_at(*cubes, elevation=HIGH, last=0.5, noise=0.0, robot=(0, 0, 0)):
    n = len(cubes)
    return camera(EXACT, pose_of(robot, cubes, elevation), np.full(n, last), np.full(n, noise))


@given(st.floats(0.15, 0.6), st.floats(-0.1, 0.1), st.floats(-4, 4))
def test_the_camera_is_a_pinhole_with_whole_pixels(ahead, left, heading):
    cos, sin = np.cos(heading), np.sin(heading)
    cube = (0.1 + cos * ahead - sin * left, 0.2 + sin * ahead + cos * left, 1.0)
    (x,) = HALF_IMAGE * seen_at(cube, robot=(0.1, 0.2, heading))
    assert x == np.rint(x)
    assert x == pytest.approx(HALF_IMAGE * tangent_view(ahead, left), abs=0.5 + 1e-6)


def test_camera_noise_is_in_pixels_and_leaves_no_image():
    exact = HALF_IMAGE * tangent_view(0.3, 0.03)
    assert HALF_IMAGE * seen_at(IN_SIGHT, noise=2.6)[0] == np.rint(exact + 2.6)
    assert seen_at(IN_SIGHT, noise=1e4)[0] == 1


@pytest.mark.parametrize("factor", [0.0, 0.5, 1.0, 4.0])
def test_the_sensor_noise_of_a_world_scales_the_cameras(factor):
    n = 200
    env = plane_with(*[IN_SIGHT] * n, params=OLD, sensor_noise=factor)
    pixels = [
        HALF_IMAGE * env.step(np.tile([0, 0, HIGH, 0, 0], (n, 1)))[0][:, 0] for _ in range(10)
    ]
    wanted = np.sqrt((factor * EXACT.camera_noise) ** 2 + (1 / 12 if factor else 0))  # rounded
    assert np.std(pixels) == pytest.approx(wanted, rel=5 / np.sqrt(20 * n) + 0.02)
    assert np.mean(pixels) == pytest.approx(
        HALF_IMAGE * tangent_view(0.3, 0.03),
        abs=0.5 if factor == 0 else 5 * wanted / np.sqrt(10 * n),
    )


def test_a_cube_out_of_view_keeps_the_last_x():
    edge = 0.3 * np.tan(EXACT.field_of_view / 2)
    x = seen_at((0.3, edge - 1e-6, 0), (0.3, edge + 1e-6, 0), (-0.3, 0, 0), (0, 0.3, 0), last=0.25)
    np.testing.assert_array_equal(x, [-1, 0.25, 0.25, 0.25])


@pytest.mark.parametrize(
    ("cube", "elevation", "hidden"),
    [  # the sight from 10 cm to 3 cm high passes over the head, or into it
        ((0.300, 0.00, 0), 0.07, True),  # at 6.85 cm
        ((0.300, 0.07, 0), 0.07, True),  # 3.15 cm beside its middle
        ((0.300, 0.08, 0), 0.07, False),  # 3.6 cm beside it
        ((0.300, 0.00, 0), LOW, False),
        ((0.300, 0.00, 0), HIGH, False),
        ((0.195, 0.00, 0), LOW, False),  # at 5.15 cm, over its upper edge
        ((0.185, 0.00, 0), LOW, True),  # at 4.89 cm
        ((0.130, 0.00, 0), 0.07, False),  # nearer than the head
    ],
)
def test_a_cube_hidden_behind_the_head_keeps_the_last_x(cube, elevation, hidden):
    x = seen_at(cube, elevation=elevation, last=0.25)[0]
    assert (x == 0.25) == hidden


def test_turning_away_the_camera_remembers_the_side_and_a_cube_never_seen_reads_0():
    env = plane_with((0.3, 0.05, 0), (-0.1, 0.2, 0))
    assert env.step(np.tile([0, 0, HIGH, 0, 0], (2, 1)))[0][1, 0] == 0
    seen, *_ = send(env, [0.02, -0.02, HIGH, 0, 0], 5)
    assert seen[0, 0] < -0.9
    again, *_ = send(env, [0.02, -0.02, HIGH, 0, 0], 1)
    assert again[0, 0] == seen[0, 0]


# Enki's response to a surface, centimetres to counts, and back.


def enki(cm):
    return np.where(cm < 0.5, 3000 - 440 * cm, np.where(cm < 9, 4526 * np.exp(-0.9994 * cm), 0))


def centimetres(counts):
    if counts > 3000 - 440 * 0.5:
        return max(3000 - counts, 0) / 440
    return np.clip(np.log(4526 / max(counts, 1e-9)) / 0.9994, 0.5, 9)


@pytest.mark.parametrize(
    ("cm", "counts"),
    [
        (0, 3000), (0.25, 2890), (0.49, 2784.4), (0.5, 4526 * np.exp(-0.4997)),
        (2, 4526 * np.exp(-1.9988)), (8.99, 4526 * np.exp(-0.9994 * 8.99)), (9, 0), (20, 0),
    ],
)  # fmt: skip
def test_infrared_is_enkis(cm, counts):
    assert infrared(cm / 100, 0.09) == pytest.approx(counts)


@given(st.floats(0, 0.09, exclude_max=True))
def test_a_linearised_response_is_the_distance(distance):
    assert linearised(infrared(distance, 0.09), 0.09) == pytest.approx(
        1 - distance / 0.09, abs=1e-9
    )


def test_a_proximeter_saturates_at_touching_and_reads_0_for_no_response():
    np.testing.assert_array_equal(linearised(np.array([3000, 3001, 9000]), 0.09), 1)
    np.testing.assert_array_equal(linearised(np.array([0, -5]), 0.09), 0)
    touching = pose_of(cube=(EXACT.reach + EXACT.side / 2, 0, 0))
    np.testing.assert_array_equal(proximeters(EXACT, touching, 0.03)[0, 1:5], 1)


@pytest.mark.parametrize("distance", [0.01, 0.04, 0.06])
def test_a_face_straight_ahead_reads_its_distance_to_a_count(distance):
    cube = (EXACT.reach + distance + EXACT.side / 2, 0, 0)
    narrow = replace(EXACT, beam_half_angle=0.0)
    count = 1 / (0.9994 * 100 * EXACT.proximeter_range * enki(100 * distance))
    np.testing.assert_allclose(
        proximeters(narrow, pose_of(cube=cube))[0, 1:5],
        1 - distance / EXACT.proximeter_range,
        atol=0.51 * count,
    )


def test_proximeters_see_nothing_out_of_range_or_tilted_away_or_aside():
    touching = EXACT.reach + EXACT.side / 2
    near = (touching + 0.03, 0, 0)
    assert proximeters(EXACT, pose_of(cube=near)).all()
    assert not proximeters(EXACT, pose_of(cube=(touching + 0.091, 0, 0))).any()
    assert not proximeters(EXACT, pose_of(cube=near, elevation=HIGH)).any()
    for distance in (0, 0.0005, 0.01, 0.03):
        ahead = (touching + distance, 0, 0)
        assert not proximeters(EXACT, pose_of(cube=ahead, tilt=0.0)).any()
    readings = proximeters(EXACT, pose_of(cube=(near[0], 0.05, 0)))[0]
    assert readings[0] > 0.3  # the leftmost sees a cube to the left
    assert readings[-1] == 0


@pytest.mark.parametrize("factor", [0.5, 1.0])
def test_proximeter_noise_is_a_share_of_the_response(factor):
    n = 200
    cube = (EXACT.reach + 0.02 + EXACT.side / 2, 0, 0)
    counts = []
    for env in (
        plane_with(*[cube] * n, params=OLD, sensor_noise=factor),
        plane_with(cube),
    ):
        seen, *_ = send(env, [0, 0, LOW, SCAN, 0], 4)
        counts.append(enki(100 * EXACT.proximeter_range * (1 - seen[:, 1:5].astype(float))))
    noisy, exact = counts
    share = factor * OLD.proximeter_noise
    off = noisy / exact - 1
    assert np.abs(off).max() <= share + 1.5 / exact.min()
    assert off.std() == pytest.approx(share / np.sqrt(3), rel=0.15)
    assert off.mean() == pytest.approx(0, abs=5 * share / np.sqrt(3 * off.size))


def space_with(square, side):
    space = pymunk.Space()
    body = pymunk.Body(body_type=pymunk.Body.STATIC)
    body.position, body.angle = tuple(square[:2]), square[2]
    space.add(body, pymunk.Poly.create_box(body, (side, side)))
    space.reindex_static()
    return space


def pymunks_distance(space, start, angle, length=1.0):
    end = start + length * np.array([np.cos(angle), np.sin(angle)])
    hit = space.segment_query_first(tuple(start), tuple(end), 0, pymunk.ShapeFilter())
    return np.inf if hit is None else length * hit.alpha


def test_rays_agree_with_pymunk():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(300):
        square = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-4, 4)])
        start = rng.uniform(0.15, 0.3, 2) * rng.choice([-1, 1], 2)
        angle = np.arctan2(*(square[:2] - start)[::-1]) + rng.uniform(-0.3, 0.3)
        theirs = pymunks_distance(space_with(square, 0.06), start, angle)
        ours = ray_to_square(*start[:, None, None], np.array([[angle]]), square[None], 0.06)[0, 0]
        assert ours == pytest.approx(theirs, abs=1e-6)
        hits += theirs < np.inf
    assert 50 < hits < 250


@pytest.mark.parametrize("scanning", [True, False])
def test_proximeters_agree_with_pymunks_rays_through_enkis_curve(scanning):
    """The mean response of five rays in 16°, half a count up or down."""
    rng = np.random.default_rng(1)
    readings = []
    for _ in range(300):
        robot = np.array([*rng.uniform(-0.2, 0.5, 2), rng.uniform(-4, 4)])
        cos, sin = np.cos(robot[2]), np.sin(robot[2])
        turned = np.array([[cos, -sin], [sin, cos]])
        place = [EXACT.reach + rng.uniform(0.043, 0.13), rng.uniform(-0.06, 0.06)]
        cube = np.array([*(robot[:2] + turned @ place), rng.uniform(-4, 4)])
        elevation, tilt = (LOW, SCAN) if scanning else rng.uniform([LOW, 0.9], [0.08, SCAN])
        ours = proximeters(EXACT, pose_of(robot, cube, elevation, tilt))[0]
        space = space_with(cube, EXACT.side)
        pitch = SCAN - tilt
        for reading, offset in zip(ours, EXACT.proximeter_offsets, strict=True):
            start = robot[:2] + turned @ [EXACT.reach, offset]
            counts = []
            for spread in np.deg2rad([-8, -4, 0, 4, 8]):
                level = min(pymunks_distance(space, start, robot[2] + spread), 1.0)
                over = elevation + level * np.tan(pitch) > EXACT.side
                counts.append(0.0 if over else enki(100 * level / np.cos(pitch)))
            nearest, farthest = (centimetres(np.mean(counts) + c) for c in (0.51, -0.51))
            assert nearest - 1e-9 <= 9 * (1 - reading) <= farthest + 1e-9
            readings.append(reading)
    assert 0.1 < np.mean(np.array(readings) > 0) < 0.9
