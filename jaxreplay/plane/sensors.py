"""What the robot sees: 7 values from the poses of all worlds at once.

Noise is handed in as numbers drawn elsewhere, so that all here is a pure function.
"""

from typing import NamedTuple

import numpy as np

from jaxreplay.plane.params import PlaneParams

# Enki's infrared response to a distance in cm, in counts: a line up to `_KNEE`, then an
# exponential up to 9 cm.
_TOUCHING, _SLOPE, _KNEE = 3000.0, 440.0, 0.5
_SCALE, _RATE = 4526.0, 0.9994


class Pose(NamedTuple):
    """Where everything is, in B worlds.

    Attributes:
        robot: `[B, 3]` x, y (m) and heading (rad) of the robot.
        cube: `[B, 3]` x, y (m) and angle (rad) of the cube.
        elevation: `[B]` height of the middle of the gripper head, m.
        tilt: `[B]` of the gripper head, rad; 0 grasps, π/2 scans.
    """

    robot: np.ndarray
    cube: np.ndarray
    elevation: np.ndarray
    tilt: np.ndarray


def camera(
    params: PlaneParams, pose: Pose, last: np.ndarray, noise: np.ndarray | float = 0.0
) -> np.ndarray:
    """The cube's x in the image, `[B]`, from −1 (left edge) to 1 (right edge), in whole pixels.

    A pinhole: tan(bearing) over tan of half the field of view. While the cube is out of view,
    or its centre hidden behind the gripper head, the tracker keeps the x it saw last (`last`,
    `[B]`). `noise` is `[B]`, in pixels.
    """
    ahead, left = in_frame(pose.robot, pose.cube[:, :2])
    half = params.image_width / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        x = -left / ahead / np.tan(params.field_of_view / 2)
        along = params.reach / ahead  # share of the line of sight up to the head
    in_view = (ahead > 0) & (np.abs(x) <= 1)
    drop = params.camera_height - params.side / 2
    sight = params.camera_height - drop * along
    hidden = (along < 1) & (np.abs(left * along) < params.gripper_width / 2)
    hidden &= np.abs(sight - pose.elevation) < params.head
    pixel = np.clip(np.rint(x * half + noise), -half, half)
    return np.where(in_view & ~hidden, pixel / half, last)


def proximeters(params: PlaneParams, pose: Pose, noise: np.ndarray | float = 0.0) -> np.ndarray:
    """Linearised readings `[B, 6]`: 1 touching, falling to 0 at the end of the range.

    A beam is a fan of rays around the head's direction; it receives the mean of their
    responses, in whole counts. With the head tilted away from scanning the beams point up: a ray
    meets the cube only where it is not higher than it, and none comes back at a steep angle.
    `noise` is `[B, 6]`, a share of the response.
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


def proximeter_rays(params: PlaneParams, pose: Pose) -> tuple[np.ndarray, ...]:
    """Origins x and y (m) and directions (rad) of all rays as seen from above, `[B, 6 · rays]`."""
    fan = np.linspace(-1, 1, params.beam_rays) * params.beam_half_angle
    offsets = np.repeat(params.proximeter_offsets, params.beam_rays)
    heading = pose.robot[:, 2:3]
    cos, sin = np.cos(heading), np.sin(heading)
    x = pose.robot[:, 0:1] + params.reach * cos - offsets * sin
    y = pose.robot[:, 1:2] + params.reach * sin + offsets * cos
    return x, y, heading + np.tile(fan, len(params.proximeter_offsets))


def infrared(distance: np.ndarray, end: float) -> np.ndarray:
    """Response in counts to a surface at a distance (m), as Enki has it; 0 from `end` on."""
    cm = 100 * distance
    counts = np.where(cm < _KNEE, _TOUCHING - _SLOPE * cm, _SCALE * np.exp(-_RATE * cm))
    return np.where(distance < end, counts, 0.0)


def linearised(counts: np.ndarray, end: float) -> np.ndarray:
    """1 − distance/end, with the distance that the response tells; within [0, 1].

    More counts than touching gives (noise) are taken for touching: there the sensor saturates.
    """
    knee = _TOUCHING - _SLOPE * _KNEE
    near = (_TOUCHING - np.minimum(counts, _TOUCHING)) / _SLOPE
    far = np.log(_SCALE / np.maximum(counts, 1e-9)) / _RATE
    cm = np.where(counts > knee, near, np.maximum(far, _KNEE))
    return np.clip(1 - cm / (100 * end), 0.0, 1.0)


def ray_to_square(
    x: np.ndarray, y: np.ndarray, angle: np.ndarray, square: np.ndarray, side: float
) -> np.ndarray:
    """Distance `[B, R]` along rays from (x, y) to a square each, 0 inside it, inf if missed.

    `square` is `[B, 3]`, x, y and angle of its centre. Slabs: a ray is inside the square while
    it is between both pairs of parallel sides.
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
    """A point `[B, 2]` as (ahead, left) of frames `[B, 3]`."""
    dx, dy = (point - frame[:, :2]).T
    cos, sin = np.cos(frame[:, 2]), np.sin(frame[:, 2])
    return cos * dx + sin * dy, cos * dy - sin * dx
