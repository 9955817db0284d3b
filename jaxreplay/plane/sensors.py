"""The robot's sensors: 7 values from the poses of B worlds.

Noise is an argument, drawn elsewhere, so that every function here is pure.
"""

from typing import NamedTuple

import numpy as np

from jaxreplay.plane.params import PlaneParams

# Enki's infrared response in counts to a distance d in cm:
# _TOUCHING − _SLOPE · d below _KNEE, then _SCALE · exp(−_RATE · d) up to 9 cm.
_TOUCHING, _SLOPE, _KNEE = 3000.0, 440.0, 0.5
_SCALE, _RATE = 4526.0, 0.9994


class Pose(NamedTuple):
    """Where robot, gripper and cube are, in B worlds.

    Attributes:
        robot: `[B, 3]` x, y (m) and heading (rad) of the robot.
        cube: `[B, 3]` x, y (m) and angle (rad) of the cube.
        elevation: `[B]` height of the middle of the gripper head, m.
        tilt: `[B]` of the gripper head, rad; at 0 it grasps, at π/2 it scans.
    """

    robot: np.ndarray
    cube: np.ndarray
    elevation: np.ndarray
    tilt: np.ndarray


def camera(
    params: PlaneParams, pose: Pose, last: np.ndarray, noise: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return the cube's x in the image, `[B]`, from −1 (left edge) to 1 (right edge).

    A pinhole camera, rounded to whole pixels:

        x = tan(bearing to the right) / tan(field of view / 2)

    While the cube is out of view, or its centre hidden behind the gripper head, x stays at the
    value that was seen last.

    Args:
        params: the constants.
        pose: of the worlds.
        last: `[B]` the values of the step before.
        noise: `[B]` in pixels.
    """
    ahead, left = in_frame(pose.robot, pose.cube[:, :2])
    half = params.image_width / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        x = -left / ahead / np.tan(params.field_of_view / 2)
        along = params.reach / ahead  # the head's place on the line of sight, as a share of it
    in_view = (ahead > 0) & (np.abs(x) <= 1)
    drop = params.camera_height - params.side / 2
    sight = params.camera_height - drop * along
    hidden = (along < 1) & (np.abs(left * along) < params.gripper_width / 2)
    hidden &= np.abs(sight - pose.elevation) < params.head
    pixel = np.clip(np.rint(x * half + noise), -half, half)
    return np.where(in_view & ~hidden, pixel / half, last)


def proximeters(params: PlaneParams, pose: Pose, noise: np.ndarray | float = 0.0) -> np.ndarray:
    """Return the readings of the proximeters, `[B, 6]`: 1 touching, 0 from the range's end on.

    A beam is a fan of rays around the head's direction; its response is the mean of theirs, in
    whole counts, and its reading is linear in the distance that this response stands for. Where
    the head is tilted away from scanning the beams point up: a ray that passes above the cube
    misses it, and a ray that is too steep is not reflected back.

    Args:
        params: the constants.
        pose: of the worlds.
        noise: `[B, 6]` as a share of the response.
    """
    distance = ray_to_square(*proximeter_rays(params, pose), pose.cube, params.side)
    pitch = params.scanning_tilt - pose.tilt[:, None]
    missed = np.isinf(distance) | (pitch > params.beam_steepest)
    pitch = np.minimum(pitch, params.beam_steepest)
    distance = np.where(missed, params.proximeter_range, distance)
    hit_height = pose.elevation[:, None] + distance * np.tan(pitch)
    missed |= (hit_height < 0) | (hit_height > params.side)
    response = np.where(missed, 0.0, infrared(distance / np.cos(pitch), params.proximeter_range))
    received = response.reshape(len(response), -1, params.beam_rays).mean(axis=2)
    return linearised(np.rint(received * (1 + noise)), params.proximeter_range)


def proximeter_rays(params: PlaneParams, pose: Pose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rays of the six beams as seen from above, R = 6 · `beam_rays`.

    Returns:
        Their origins' x and y (m) and their directions (rad), `[B, R]` each.
    """
    fan = np.linspace(-1, 1, params.beam_rays) * params.beam_half_angle
    offsets = np.repeat(params.proximeter_offsets, params.beam_rays)
    heading = pose.robot[:, 2:3]
    cos, sin = np.cos(heading), np.sin(heading)
    x = pose.robot[:, 0:1] + params.reach * cos - offsets * sin
    y = pose.robot[:, 1:2] + params.reach * sin + offsets * cos
    return x, y, heading + np.tile(fan, len(params.proximeter_offsets))


def infrared(distance: np.ndarray, end: float) -> np.ndarray:
    """Return Enki's response in counts to surfaces at distances (m); 0 from `end` (m) on."""
    cm = 100 * distance
    counts = np.where(cm < _KNEE, _TOUCHING - _SLOPE * cm, _SCALE * np.exp(-_RATE * cm))
    return np.where(distance < end, counts, 0.0)


def linearised(counts: np.ndarray, end: float) -> np.ndarray:
    """Return 1 − distance / end, within [0, 1], for the distance that causes these counts.

    This inverts :func:`infrared`; `end` is in m. Counts above those of a surface that touches,
    which noise can cause, read as touching: the sensor saturates.
    """
    knee = _TOUCHING - _SLOPE * _KNEE
    near = (_TOUCHING - np.minimum(counts, _TOUCHING)) / _SLOPE
    far = np.log(_SCALE / np.maximum(counts, 1e-9)) / _RATE
    cm = np.where(counts > knee, near, np.maximum(far, _KNEE))
    return np.clip(1 - cm / (100 * end), 0.0, 1.0)


def ray_to_square(
    x: np.ndarray, y: np.ndarray, angle: np.ndarray, square: np.ndarray, side: float
) -> np.ndarray:
    """Return the distances along rays to a square, `[B, R]` in m: 0 from inside, inf if missed.

    By the slab method: a ray is inside the square where it is between both pairs of parallel
    sides.

    Args:
        x: `[B, R]` of the rays' origins, m.
        y: `[B, R]` of the rays' origins, m.
        angle: `[B, R]` the rays' directions, rad.
        square: `[B, 3]` x, y (m) and angle (rad) of the squares.
        side: of the squares, m.
    """
    cos, sin = np.cos(square[:, 2:]), np.sin(square[:, 2:])
    dx, dy = x - square[:, 0:1], y - square[:, 1:2]
    origin = np.stack([cos * dx + sin * dy, cos * dy - sin * dx])
    direction = np.stack([np.cos(angle - square[:, 2:]), np.sin(angle - square[:, 2:])])
    direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
    sides = np.stack([(-side / 2 - origin) / direction, (side / 2 - origin) / direction])
    enter = np.maximum(sides.min(axis=0).max(axis=0), 0.0)
    leave = sides.max(axis=0).min(axis=0)
    return np.where(enter <= leave, enter, np.inf)


def in_frame(frame: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far points are ahead and to the left in frames, `[B]` each in m.

    Args:
        frame: `[B, 3]` x, y (m) and angle (rad).
        point: `[B, 2]` x and y, m.
    """
    dx, dy = (point - frame[:, :2]).T
    cos, sin = np.cos(frame[:, 2]), np.sin(frame[:, 2])
    return cos * dx + sin * dy, cos * dy - sin * dx
