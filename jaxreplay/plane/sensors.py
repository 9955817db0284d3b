"""What the robot sees: 7 values from the poses of all worlds at once, without noise."""

from typing import NamedTuple

import numpy as np

from jaxreplay.plane.params import PlaneParams


class PlaneState(NamedTuple):
    """What changes each step, for B worlds.

    Attributes:
        robot: `[B, 3]` x, y (m) and heading (rad) of the robot.
        cube: `[B, 3]` x, y (m) and angle (rad) of the cube.
        elevation: `[B]` height of the gripper head, m.
        tilt: `[B]` of the gripper head, rad; 0 grasps, π/2 scans.
        held: `[B]` whether the magnet holds the cube.
    """

    robot: np.ndarray
    cube: np.ndarray
    elevation: np.ndarray
    tilt: np.ndarray
    held: np.ndarray


def camera(params: PlaneParams, state: PlaneState, side_seen: np.ndarray) -> np.ndarray:
    """The cube's x in the image, `[B]`, from −1 (left edge) to 1 (right edge).

    A pinhole: tan(bearing) over tan of half the field of view. A cube out of view reads −1 or 1,
    the side of the image it was last seen on (`side_seen`, `[B]`, 0 before it was ever seen).
    """
    ahead, left = _in_frame(state.robot, state.cube[:, :2])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = -left / ahead / np.tan(params.field_of_view / 2)
    return np.where((ahead > 0) & (np.abs(x) <= 1), x, side_seen)


def proximeters(params: PlaneParams, state: PlaneState) -> np.ndarray:
    """Linearised readings `[B, 6]`: 1 touching, falling to 0 at the end of the range.

    A beam is a fan of rays around the head's direction, and reads their mean. With the head
    tilted away from scanning the beams point up and leave over the cube: a ray at a slant
    meets it only where it is not higher than the cube.
    """
    fan = np.linspace(-1, 1, params.beam_rays) * params.beam_half_angle
    offsets = np.repeat(params.proximeter_offsets, params.beam_rays)
    heading = state.robot[:, 2:3]
    cos, sin = np.cos(heading), np.sin(heading)
    x = state.robot[:, 0:1] + params.reach * cos - offsets * sin
    y = state.robot[:, 1:2] + params.reach * sin + offsets * cos
    distance = ray_to_square(
        x, y, heading + np.tile(fan, len(params.proximeter_offsets)), state.cube, params.side
    )
    pitch = np.minimum(params.scanning_tilt - state.tilt[:, None], 1.5)  # short of straight up
    missed = np.isinf(distance)
    distance = np.where(missed, params.proximeter_range, distance)
    hit_height = state.elevation[:, None] + distance * np.tan(pitch)
    slant = distance / np.cos(pitch)
    seen = ~missed & (hit_height >= 0) & (hit_height <= params.side)
    reading = np.where(seen, np.clip(1 - slant / params.proximeter_range, 0, 1), 0.0)
    return reading.reshape(len(reading), -1, params.beam_rays).mean(axis=2)


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


def magnet_to_face(params: PlaneParams, state: PlaneState) -> tuple[np.ndarray, ...]:
    """Where the magnet is before the face of the cube that is turned to it, each `[B]`.

    Returns:
        The gap to the face's plane (m, negative inside), the lateral distance to the face's
        centre (m, signed) and the angle between magnet and face (rad, signed).
    """
    heading = state.robot[:, 2]
    magnet = state.robot[:, :2] + params.reach * np.stack([np.cos(heading), np.sin(heading)], 1)
    quarter = np.pi / 2
    turns = np.round((heading - state.cube[:, 2]) / quarter) * quarter
    face = np.concatenate([state.cube[:, :2], (state.cube[:, 2] + turns)[:, None]], axis=1)
    inward, lateral = _in_frame(face, magnet)
    return -inward - params.side / 2, lateral, heading - face[:, 2]


def _in_frame(frame: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A point `[B, 2]` as (ahead, left) of frames `[B, 3]`."""
    dx, dy = (point - frame[:, :2]).T
    cos, sin = np.cos(frame[:, 2]), np.sin(frame[:, 2])
    return cos * dx + sin * dy, cos * dy - sin * dx
