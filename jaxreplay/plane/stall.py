"""Classification of the runs that reach the time limit: fixed, cyclic or slow.

In § 3, "fixed or cyclic" is said of the distribution over I, τ. Here it is the robot's pose that is
examined, so that runs can be classified without their beliefs.
"""

from typing import Literal

import numpy as np

STALL_SECONDS = 60.0  # the part of a run that is examined, before its end
# Largest motion of what counts as still: x, y (m), heading (rad), elevation (m), tilt (rad).
_STILL = np.array([0.005, 0.005, np.deg2rad(2), 0.005, np.deg2rad(2)])
_TURN = 2 * np.pi / _STILL[2]  # a whole turn in units of `_STILL`
_SHORTEST, _LONGEST = 1.0, 30.0  # s, of a cycle
_CLOSED = 0.25  # a cycle returns to within this share of its size


def stall(trail: np.ndarray, period: float) -> Literal["fixed", "cyclic", "slow"]:
    """Return how a run that reached the time limit ended, from its last 60 s of poses.

    Coordinates x_k are in units of 5 mm and 2°.

    - fixed: no coordinate moves by as much as one unit: max x_k − min x_k < 1 for every k.
    - cyclic: for some lag between 1 and 30 s the pose recurs,

        max_k d_k < ¼ max_k s_k, and d_k < max(¼ s_k, 1) for every k,

      where d_k is the largest |x_k(t) − x_k(t − lag)| over the trail's second half (headings
      modulo a whole turn), and s_k is max x_k − min x_k during the last lag.
    - slow: otherwise.

    Args:
        trail: `[T, 5]` the last poses of the run: the robot's x, y (m) and heading (rad, not
            wrapped), the gripper's elevation (m) and tilt (rad).
        period: time between poses, s.
    """
    scaled = trail / _STILL
    if np.ptp(scaled, axis=0).max() < 1:
        return "fixed"
    half = len(scaled) // 2
    for lag in range(round(_SHORTEST / period), min(round(_LONGEST / period), half) + 1):
        apart = scaled[half:] - scaled[half - lag : len(scaled) - lag]
        apart[:, 2] -= np.round(apart[:, 2] / _TURN) * _TURN
        apart, size = np.abs(apart).max(axis=0), np.ptp(scaled[-lag:], axis=0)
        if apart.max() < _CLOSED * size.max() and (apart < np.maximum(_CLOSED * size, 1)).all():
            return "cyclic"
    return "slow"
