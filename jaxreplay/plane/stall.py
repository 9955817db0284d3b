"""Telling apart the ways in which a run does not end (§ 3: "fixed or cyclic")."""

import numpy as np

STALL_SECONDS = 60.0  # how much of the end of a run is looked at
_STILL = np.array([0.005, 0.005, np.deg2rad(2), 0.005, np.deg2rad(2)])  # m, m, rad, m, rad
_TURN = 2 * np.pi / _STILL[2]
_SHORTEST, _LONGEST = 1.0, 30.0  # s, of a cycle
_CLOSED = 0.25  # a cycle comes back within this share of its size


def stall(trail: np.ndarray, period: float) -> str:
    """`"fixed"`, `"cyclic"` or `"slow"`, from where base and gripper were in the last 60 s.

    Fixed: neither moved by more than 5 mm or 2°. Cyclic: some lag of 1 to 30 s brings back the
    same pose, over and over for 30 s, within a quarter of the motion in between, in what moves
    most, and in all else within that or 5 mm or 2°. Else slow.

    Args:
        trail: `[T, 5]` x, y (m) and heading (rad, counted on over whole turns) of the robot,
            elevation (m) and tilt (rad) of the gripper, the last ones of the run.
        period: s between them.
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
