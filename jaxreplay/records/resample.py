"""Records at another rate: what a robot with another control period would have recorded."""

import numpy as np


def resample(
    sensors: np.ndarray, commands: np.ndarray, ratio: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return one record at another rate.

    Row t is the command of one period and the observation at its end. So a new row's command is the
    mean of the commands during the new period, and its observation lies on the straight line
    between those recorded before and after the new period's end. Before the first observation, that
    one stands. What is left of a last, incomplete period is dropped.

    Args:
        sensors: `[L, n_s]`.
        commands: `[L, n_u]`.
        ratio: the new period divided by the old one.

    Returns:
        `[L', n_s]` and `[L', n_u]`, with L' = L / ratio rounded down, at least 1.
    """
    n = max(int(len(sensors) / ratio + 1e-6), 1)
    ends = np.minimum(ratio * np.arange(n + 1), len(sensors))
    rows = np.arange(1, len(sensors) + 1)  # row t is observed at the end of period t
    observed = np.column_stack([np.interp(ends[1:], rows, column) for column in sensors.T])
    total = np.vstack([np.zeros(commands.shape[1]), np.cumsum(commands, axis=0)])
    at = np.arange(len(total))
    integral = np.column_stack([np.interp(ends, at, column) for column in total.T])
    return observed, np.diff(integral, axis=0) / np.diff(ends)[:, None]
