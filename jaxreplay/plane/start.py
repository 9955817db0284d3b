"""What differs from run to run of one robot: its tracks' gains, where it and the cube are put."""

from typing import NamedTuple

import numpy as np

from jaxreplay.plane.actuators import Settings


class Start(NamedTuple):
    """The differences of one world.

    Attributes:
        gain: `[2]` factors on the speeds of the left and right track.
        robot: `[3]` x, y (m) and heading (rad).
        cube: `[3]` x, y (m) and angle (rad).
    """

    gain: np.ndarray
    robot: np.ndarray
    cube: np.ndarray


def start_of(settings: Settings, b: int, seed: int, cube: np.ndarray) -> Start:
    """Draw the start of the world in slot b, with u uniform in [−1, 1] for each number.

        gain = 1 + track_bias · u;   x, y = placing · u;   heading · u;   angle + cube_turn · u

    All u follow from the seed alone. So a world with another setting differs in that alone.

    Args:
        settings: of all slots.
        b: the slot.
        seed: of the world.
        cube: `[3]` where the cube is meant to be put.
    """
    u = np.random.default_rng([seed, 3]).uniform(-1, 1, 6)
    placing, heading = settings.placing[b], settings.heading[b]
    return Start(
        gain=1 + settings.track_bias[b] * u[:2],
        robot=np.array([placing, placing, heading]) * u[2:5],
        cube=cube + np.array([0.0, 0.0, settings.cube_turn[b] * u[5]]),
    )
