"""Positions of cubes in m from the robot's start: x ahead, y to its left.

The paper's figure 2 shows 20 demonstrated and 5 test positions, 25–40 cm ahead and up to 10 cm
to either side, without coordinates. A regular grid is an assumption, and so is that each cube is
placed with a face turned to the robot's start (:func:`facing`).
"""

import numpy as np

# `[20, 2]` and `[5, 2]` x and y, m.
DEMONSTRATED = np.array(
    [(x, y) for x in np.linspace(0.25, 0.40, 4) for y in np.linspace(-0.1, 0.1, 5)]
)
TESTED = np.array(
    [(0.275, -0.075), (0.275, 0.025), (0.325, 0.075), (0.375, -0.025), (0.375, 0.075)]
)
# Where a cube can be put in the experimental area without touching the robot: lowest, highest; m.
CUBE_X, CUBE_Y = (0.2, 0.7), (-0.3, 0.3)


def facing(positions: np.ndarray) -> np.ndarray:
    """Return cubes at some positions, each with a face turned to the robot's start.

    Args:
        positions: `[B, 2]` x and y, m.

    Returns:
        `[B, 3]` x, y (m) and angle (rad).
    """
    positions = np.asarray(positions, dtype=float)
    return np.column_stack([positions, np.arctan2(positions[:, 1], positions[:, 0])])
