"""Classification of the runs that do not end (§ 3: "fixed or cyclic")."""

from typing import Literal

import numpy as np

STALL_SECONDS = 60.0  # the part of a run that is examined, before its end
# Largest motion of what counts as still: x, y (m), heading (rad), elevation (m), tilt (rad).
_STILL = np.array([0.005, 0.005, np.deg2rad(2), 0.005, np.deg2rad(2)])
_TURN = 2 * np.pi / _STILL[2]  # a whole turn in units of `_STILL`
_SHORTEST, _LONGEST = 1.0, 30.0  # s, of a cycle
_CLOSED = 0.25  # a cycle returns to within this share of its size


def stall(trail: np.ndarray, period: float) -> Literal["fixed", "cyclic", "slow"]:
    """Return the kind of stall, from the poses of base and gripper in the last 60 s of a run.

    - fixed: no coordinate moves by more than one unit, 5 mm or 2°.
    - cyclic: there is a lag between 1 and 30 s after which the pose recurs, at all times of the
      trail's second half: each coordinate comes back to within a quarter of the largest motion
      of any coordinate during the last lag (in units), and to within a quarter of its own
      motion or one unit, whichever is more.
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
