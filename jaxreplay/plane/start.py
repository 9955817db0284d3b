"""What differs from run to run of one robot: its tracks, where it and the cube are put, a push."""

from typing import NamedTuple

import numpy as np

from jaxreplay.plane.actuators import Settings

PUSH_SECONDS = 1.0  # how long a push takes; assumption
PUSHED_BEFORE = 40.0  # s; a push begins at a moment uniform in [0, this); assumption


class Start(NamedTuple):
    """The differences of one world.

    Attributes:
        gain: `[2]` factors on the speeds of the left and right track.
        robot: `[3]` x, y (m) and heading (rad).
        cube: `[3]` x, y (m) and angle (rad).
        push: `[3]` speeds that a push adds to the left and right track (m/s), and when it begins
            (s).
    """

    gain: np.ndarray
    robot: np.ndarray
    cube: np.ndarray
    push: np.ndarray


def start_of(settings: Settings, b: int, seed: int, cube: np.ndarray) -> Start:
    """Draw the start of the world in slot b, with u uniform in [−1, 1] for each number.

        gain = 1 + track_bias · u;   x, y = placing · u;   heading · u;   angle + cube_turn · u
        push · u / PUSH_SECONDS for each track

    All u follow from the seed alone. So a world with another setting differs in that alone.

    Args:
        settings: of all slots.
        b: the slot.
        seed: of the world.
        cube: `[3]` where the cube is meant to be put.
    """
    u = np.random.default_rng([seed, 3]).uniform(-1, 1, 9)
    placing, heading = settings.placing[b], settings.heading[b]
    return Start(
        gain=1 + settings.track_bias[b] * u[:2],
        robot=np.array([placing, placing, heading]) * u[2:5],
        cube=cube + np.array([0.0, 0.0, settings.cube_turn[b] * u[5]]),
        push=np.array([*settings.push[b] * u[6:8] / PUSH_SECONDS, PUSHED_BEFORE * (u[8] + 1) / 2]),
    )


def push_speeds(push: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the speeds that pushes `[B, 3]` add to the tracks at a time `[B]` in s: `[B, 2]`."""
    lasts = (time >= push[:, 2]) & (time < push[:, 2] + PUSH_SECONDS)
    return np.where(lasts[:, None], push[:, :2], 0.0)
