"""What becomes of a command in tracks, servos and magnet, for B worlds at once."""

from typing import NamedTuple

import numpy as np

from jaxreplay.plane.params import GRAVITY, PlaneParams
from jaxreplay.plane.sensors import Pose, in_frame


class Settings(NamedTuple):
    """What may differ between worlds, each `[B]`; see :class:`PlaneParams`."""

    motor_unit: np.ndarray
    dithering: np.ndarray
    battery: np.ndarray
    sensor_noise: np.ndarray


def track_speeds(
    params: PlaneParams,
    settings: Settings,
    command: np.ndarray,
    chance: np.ndarray,
    noise: np.ndarray,
) -> np.ndarray:
    """Speeds `[B, 2]` in m/s of tracks told to run at `command` `[B, 2]`, in m/s.

    They run at whole motor units, the nearest ones; with dithering (§ 3), the one above with a
    probability equal to the fraction, so that the mean is what was commanded.

    Args:
        params: the constants.
        settings: of the worlds.
        command: `[B, 2]` left and right.
        chance: `[B, 2]` uniform in [0, 1).
        noise: `[B, 2]` uniform in [−1, 1).
    """
    unit = settings.motor_unit[:, None]
    limit = np.floor(params.top_speed / unit + 1e-9)
    wanted = np.clip(command / unit, -limit, limit)
    dithered = np.clip(np.floor(wanted + chance), -limit, limit)
    whole = np.where(settings.dithering[:, None], dithered, np.rint(wanted))
    return whole * unit * (1 + params.wheel_noise * noise)


class Servo(NamedTuple):
    """An axis controlled in position. SI units.

    Attributes:
        low: least position.
        high: greatest position.
        speed: on a full battery, per s.
        resolution: set points are rounded to its multiples.
        dead_band: a servo this close to its set point stays where it is.
        restart: s that it stands still after a new set point arrived.
    """

    low: float
    high: float
    speed: float
    resolution: float
    dead_band: float
    restart: float

    def move(
        self,
        position: np.ndarray,
        set_point: np.ndarray,
        command: np.ndarray,
        battery: np.ndarray,
        period: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Position and set point, `[B]` each, after one control step.

        "They do not cope well with rapid changes of set points" (§ 3): each change costs the
        time of a restart, so one whose set point changes every step moves for part of it only.
        """
        wanted = np.rint(np.clip(command, self.low, self.high) / self.resolution) * self.resolution
        wanted = np.clip(wanted, self.low, self.high)
        running = np.maximum(period - np.where(wanted == set_point, 0.0, self.restart), 0.0)
        reach = self.speed * battery * running
        error = wanted - position
        moved = position + np.clip(error, -reach, reach)
        return np.where(np.abs(error) > self.dead_band, moved, position), wanted


def elevation_servo(params: PlaneParams) -> Servo:
    """The one that raises the gripper."""
    p = params
    return Servo(
        p.low, p.high, p.elevation_speed, p.elevation_resolution, p.elevation_dead_band,
        p.servo_restart,
    )  # fmt: skip


def tilt_servo(params: PlaneParams) -> Servo:
    """The one that turns the gripper's head."""
    p = params
    return Servo(
        0.0, p.scanning_tilt, p.tilt_speed, p.tilt_resolution, p.tilt_dead_band, p.servo_restart
    )


def rests_on_cube(params: PlaneParams, pose: Pose) -> np.ndarray:
    """`[B]` least height of the head: lowered over the cube it comes to rest on it."""
    ahead, left = in_frame(pose.robot, pose.cube[:, :2])
    turned = pose.cube[:, 2] - pose.robot[:, 2]
    extent = params.side / 2 * (np.abs(np.cos(turned)) + np.abs(np.sin(turned)))
    over = (ahead > 0) & (ahead < params.reach + extent)
    over &= np.abs(left) < params.gripper_width / 2 + extent
    top = params.side + params.head
    return np.where(over & (pose.elevation >= top), top, params.low)


def magnet_to_face(params: PlaneParams, pose: Pose) -> tuple[np.ndarray, ...]:
    """Where the magnet is before the face of the cube that is turned to it, each `[B]`.

    Returns:
        The gap to the face's plane (m, negative inside), the lateral distance to the face's
        centre (m, signed) and the angle between magnet and face (rad, signed).
    """
    heading = pose.robot[:, 2]
    magnet = pose.robot[:, :2] + params.reach * np.stack([np.cos(heading), np.sin(heading)], 1)
    quarter = np.pi / 2
    turns = np.round((heading - pose.cube[:, 2]) / quarter) * quarter
    face = np.concatenate([pose.cube[:, :2], (pose.cube[:, 2] + turns)[:, None]], axis=1)
    inward, lateral = in_frame(face, magnet)
    return -inward - params.side / 2, lateral, heading - face[:, 2]


def magnet_hold(params: PlaneParams, lateral: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Force in N, `[B]`, that a magnet can hold a face with; 0 is no hold.

    A face that is roughly square to it is drawn flush; the further beside its centre, the less
    of the magnet is covered (assumption: in proportion).
    """
    beside = np.maximum(1 - np.abs(lateral) / params.magnet_offset, 0)
    return np.where(np.abs(angle) < params.magnet_angle, params.magnet_force * beside, 0.0)


def tips(params: PlaneParams, force: np.ndarray) -> np.ndarray:
    """`[B]` whether a lifted cube tips off this hold (N): its weight acts half a side ahead."""
    weight = params.cube_mass * GRAVITY
    return force * params.magnet_radius < weight * params.side / 2
