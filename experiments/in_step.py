"""The filter with demonstrations in step: warped in time until all do the same at the same moment.

Equation 6 as printed lets a jump keep τ, which suits demonstrations that are in step. `causes.py`
replays with them, as the controller `"in_step:InStep"`.
"""

import numpy as np

from jaxreplay import Params, Records
from jaxreplay.filter.options import Options
from jaxreplay.loop.controller import FilterController


class InStep(FilterController):
    """The filter, with records in step."""

    def __init__(self, records: Records, params: Params, options: Options):
        """Begin B replays."""
        super().__init__(in_step(records), params, options)


def in_step(records: Records) -> Records:
    """Warp demonstrations in time, so that all are in the same situation at the same moment.

    Each is aligned with the one of median length: at each moment of that one it advances by 0 to 3
    samples, such that the sum of squared differences between sensors and commands, as shares of
    their ranges, is least. Tracks then run faster or slower, and drive as far as before.
    """
    sensors, commands = records.sequences()
    ranges = [np.ptp(np.concatenate(rows), axis=0) for rows in (sensors, commands)]
    both = [
        np.hstack([s / ranges[0], c / ranges[1]]) for s, c in zip(sensors, commands, strict=True)
    ]
    model = both[np.argsort([len(rows) for rows in both])[len(both) // 2]]
    warped = [
        _warped(_fitted(rows, model), s, c)
        for rows, s, c in zip(both, sensors, commands, strict=True)
    ]
    names = records.sensor_names, records.command_names
    return Records.from_sequences(*zip(*warped, strict=True), *names, records.period)


def _fitted(rows: np.ndarray, model: np.ndarray) -> np.ndarray:
    """Return the index of the row aligned with each of the model's, by dynamic programming."""
    apart = ((model[:, None] - rows) ** 2).sum(axis=2)
    usual = len(rows) / len(model)
    best, came = np.full(len(rows), np.inf), np.zeros(apart.shape, int)
    best[0] = apart[0, 0]
    for i in range(1, len(model)):
        ways = np.full((4, len(rows)), np.inf)
        for step in range(4):
            ways[step, step:] = best[: len(rows) - step] + 1e-3 * (step - usual) ** 2
        came[i] = ways.argmin(axis=0)
        best = ways.min(axis=0) + apart[i]
    path = [len(rows) - 1]
    for i in range(len(model) - 1, 0, -1):
        path.append(path[-1] - came[i, path[-1]])
    return np.array(path[::-1])


def _warped(path: np.ndarray, sensors: np.ndarray, commands: np.ndarray):
    """Return sensors and commands along a path through their rows, smoothed over a second."""
    rows = np.arange(len(sensors))
    padded = np.pad(path, 5, mode="edge")
    even = np.convolve(padded, np.full(11, 1 / 11), mode="valid")
    driven = np.vstack([[0, 0], np.cumsum(commands[:, :2], axis=0)])
    at = np.append(even, len(rows))
    at[0] = 0
    tracks = np.column_stack(
        [np.diff(np.interp(at, np.append(rows, len(rows)), d)) for d in driven.T]
    )
    seen = np.column_stack([np.interp(even, rows, s) for s in sensors.T])
    return seen, np.hstack([tracks, commands[even.round().astype(int), 2:]])
