"""Tracks, servos and magnet: what they do with a command, for B worlds at once."""

from typing import NamedTuple

import numpy as np

from jaxreplay.plane.params import GRAVITY, PlaneParams
from jaxreplay.plane.sensors import Pose, in_frame


class Settings(NamedTuple):
    """The properties that can differ between worlds.

    Attributes:
        motor_unit: `[B]` resolution of the track speeds, m/s.
        dithering: `[B]` 1 where the tracks dither, 0 where they round.
        battery: `[B]` voltage, as a share of a full battery's.
        sensor_noise: `[B]` factor on the noise of all sensors.
        track_bias: `[B]` largest difference of a track's gain from 1 (see `plane.start`).
        placing: `[B]` largest error in x and in y of where the robot is put down, m.
        heading: `[B]` largest error of its heading, rad.
        cube_turn: `[B]` largest angle by which the cube is turned, rad.
        push: `[B]` largest distance by which each track is pushed on the way, m.
    """

    motor_unit: np.ndarray
    dithering: np.ndarray
    battery: np.ndarray
    sensor_noise: np.ndarray
    track_bias: np.ndarray
    placing: np.ndarray
    heading: np.ndarray
    cube_turn: np.ndarray
    push: np.ndarray


def track_speeds(
    params: PlaneParams,
    settings: Settings,
    gain: np.ndarray,
    command: np.ndarray,
    chance: np.ndarray,
    noise: np.ndarray,
) -> np.ndarray:
    """Compute the speeds at which the tracks run, `[B, 2]` in m/s.

        speed = units · motor_unit · gain · (1 + wheel_noise · noise)

    `units` is a whole number: the one nearest to the commanded number of motor units w or, with
    dithering (§ 3), the one below or above it,

        ⌊w⌋ + 1 with probability w − ⌊w⌋, else ⌊w⌋,

    whose mean is w.

    Args:
        params: the constants.
        settings: the settings of the worlds.
        gain: `[B, 2]` of each track in this run.
        command: `[B, 2]` commanded speeds of the left and right track, m/s.
        chance: `[B, 2]` random numbers that decide the rounding of dithering, uniform in [0, 1).
        noise: `[B, 2]` relative errors of the speeds, as a share of the largest, `wheel_noise`;
            uniform in [−1, 1).
    """
    unit = settings.motor_unit[:, None]
    # 1e-9: a top speed of a whole number of units stays so when the division rounds down.
    limit = np.floor(params.top_speed / unit + 1e-9)
    wanted = np.clip(command / unit, -limit, limit)
    dithered = np.clip(np.floor(wanted + chance), -limit, limit)
    whole = np.where(settings.dithering[:, None], dithered, np.rint(wanted))
    return whole * unit * gain * (1 + params.wheel_noise * noise)


class Servo(NamedTuple):
    """An axis controlled in position; positions in m or rad.

    Attributes:
        low: lowest position.
        high: highest position.
        speed: on a full battery, m/s or rad/s.
        resolution: set points are rounded to multiples of it.
        dead_band: a servo no further than this from its set point does not move.
        restart: s for which it stands still after its set point has changed.
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
        """Return positions and set points after one control step, `[B]` each.

        "They do not cope well with rapid changes of set points" (§ 3): each change costs the
        time of a restart, so a servo whose set point changes at every step moves for only a part
        of each step.

        Args:
            position: `[B]` before the step.
            set_point: `[B]` of the step before.
            command: `[B]` the new set points, not yet rounded; clipped to the servo's range.
            battery: `[B]` share of the full voltage.
            period: duration of the step, s.
        """
        wanted = np.rint(np.clip(command, self.low, self.high) / self.resolution) * self.resolution
        wanted = np.clip(wanted, self.low, self.high)
        running = np.maximum(period - np.where(wanted == set_point, 0.0, self.restart), 0.0)
        reach = self.speed * battery * running
        error = wanted - position
        moved = position + np.clip(error, -reach, reach)
        return np.where(np.abs(error) > self.dead_band, moved, position), wanted


def elevation_servo(params: PlaneParams) -> Servo:
    """Return the servo that raises the gripper, in m."""
    p = params
    return Servo(
        p.low, p.high, p.elevation_speed, p.elevation_resolution, p.elevation_dead_band,
        p.servo_restart,
    )  # fmt: skip


def tilt_servo(params: PlaneParams) -> Servo:
    """Return the servo that tilts the gripper's head, in rad."""
    p = params
    return Servo(
        0.0, p.scanning_tilt, p.tilt_speed, p.tilt_resolution, p.tilt_dead_band, p.servo_restart
    )


def lowest_elevation(params: PlaneParams, pose: Pose) -> np.ndarray:
    """Return the lowest height of the head's middle, `[B]` in m.

    Above the cube it is higher, because there the head rests on the cube's top.
    """
    ahead, left = in_frame(pose.robot, pose.cube[:, :2])
    turned = pose.cube[:, 2] - pose.robot[:, 2]
    extent = params.side / 2 * (np.abs(np.cos(turned)) + np.abs(np.sin(turned)))
    over = (ahead > 0) & (ahead < params.reach + extent)
    over &= np.abs(left) < params.gripper_width / 2 + extent
    top = params.side + params.head
    return np.where(over & (pose.elevation >= top), top, params.low)


def magnet_to_face(params: PlaneParams, pose: Pose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute where the magnet is relative to the cube's face that is turned to it.

    Returns:
        The gap to the face's plane (m, negative inside the cube); the lateral distance from the
        face's centre (m, positive where the magnet is to its left as the robot looks at it); and
        the angle from the face's normal to the robot's heading (rad, positive where the robot is
        turned to the left), `[B]` each.
    """
    heading = pose.robot[:, 2]
    magnet = pose.robot[:, :2] + params.reach * np.stack([np.cos(heading), np.sin(heading)], 1)
    quarter = np.pi / 2
    turns = np.round((heading - pose.cube[:, 2]) / quarter) * quarter
    face = np.concatenate([pose.cube[:, :2], (pose.cube[:, 2] + turns)[:, None]], axis=1)
    inward, lateral = in_frame(face, magnet)
    return -inward - params.side / 2, lateral, heading - face[:, 2]


def holding_force(
    params: PlaneParams, lateral: np.ndarray, angle: np.ndarray | float
) -> np.ndarray:
    """Compute the largest force with which the magnet holds a face, `[B]` in N; 0: it cannot.

    A face that is roughly square to the magnet is drawn flush. The further it is from the
    magnet's centre, the less of the magnet it covers (assumption: in proportion):

        force = magnet_force · max(1 − |lateral| / magnet_offset, 0)

    Args:
        params: the constants.
        lateral: `[B]` distance to the face's centre, m; its sign does not matter.
        angle: `[B]` to the face, rad; its sign does not matter.
    """
    covered = np.maximum(1 - np.abs(lateral) / params.magnet_offset, 0)
    return np.where(np.abs(angle) < params.magnet_angle, params.magnet_force * covered, 0.0)


def tips(params: PlaneParams, force: np.ndarray) -> np.ndarray:
    """Return whether a lifted cube tips off a magnet that holds it with this force (N), `[B]`.

    The cube's weight acts half a side ahead of the face that is held.
    """
    weight = params.cube_mass * GRAVITY
    return force * params.magnet_radius < weight * params.side / 2
