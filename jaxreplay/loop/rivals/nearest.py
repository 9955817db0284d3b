"""Nearest neighbours: the commands that followed the most similar observations in the records."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from jaxreplay.filter.options import Options
from jaxreplay.loop.controller import Observed
from jaxreplay.loop.rivals.slots import (
    FromRecent,
    Rows,
    command_error,
    described,
    rows_of,
    spread_of,
    windows,
)
from jaxreplay.params import Params
from jaxreplay.records import Records

_NEIGHBOURS = (1, 5, 20)
_WINDOWS = (0.5, 1.0, 2.0, 5.0)  # s
_CLOCKS = (0.0, 1.0, 3.0, 10.0, 30.0)  # weights of time, where a sensor's is 1
_QUERIES = 600  # rows on which settings are compared


class Settings(NamedTuple):
    """What is chosen on the records.

    Attributes:
        neighbours: k.
        window: rows of recent observations.
        clock: weight of progress; 0: time is not used.
    """

    neighbours: int
    window: int
    clock: float


class NearestRecent(FromRecent):
    """Send the mean command that followed the k nearest windows of recent observations.

    It stands for visual imitation through nearest neighbours (VINN; Pari et al. 2022), with a
    memory. A window is described by means of its parts: the newest row, the 2 before it, the 4
    before these and so on. Progress t / L is one sensor more, for which a replay takes its time as
    a share of the median record, at most 1. The distance d is Euclidean, each sensor divided by its
    range; the mean is weighted by 1 / d. k, the window and the weight of progress are those with
    the least absolute error of commands, each record predicted from the others. It ends when for
    one second all k rows have been among the last 10 of their records.

    Attributes:
        settings: what was chosen.
    """

    _windows: tuple[float, ...] = _WINDOWS
    _clocks: tuple[float, ...] = _CLOCKS

    def __init__(self, records: Records, params: Params, options: Options):
        """Begin B replays; of `[B]`-batched params only B is used, of options `last_steps`."""
        rows = rows_of(records, options.counted)
        lengths = list(dict.fromkeys(rows.lasting(self._windows)))
        self.settings = choose(rows, lengths, self._clocks)
        super().__init__(rows, len(params.theta_i), self.settings.window)
        self._median = np.median(np.asarray(records.lengths))
        self._tree = KDTree(_features(rows, self.settings.window, self.settings.clock))

    def observe(self, z: np.ndarray, which: np.ndarray) -> Observed:
        """Find the nearest rows of the slots `which`, and their next commands."""
        self._recent.add(z, which)
        clock = self.settings.clock * np.minimum(self._recent.steps / self._median, 1)
        features = np.column_stack([described(self._recent.window), clock])
        k = min(self.settings.neighbours, self._tree.n)
        result = self._tree.query(features, k=k)  # without an axis of length k if k is 1
        distance, found = (np.reshape(each, (-1, k)) for each in result)
        self.command[which] = weighted(self._rows.command[found], distance)[which]
        at_end = np.asarray(self._rows.ends[found].all(axis=1))
        return Observed(self._at_end.add(at_end, which).astype(float))


class Nearest(NearestRecent):
    """Send the mean command that followed the k nearest observations; it has no memory.

    It stands for visual imitation through nearest neighbours (VINN; Pari et al. 2022), on the
    sensors themselves in place of an image's learnt features. See :class:`NearestRecent`.
    """

    _windows = (0.0,)
    _clocks = (0.0,)


class NearestTimed(NearestRecent):
    """Send what :class:`NearestRecent` does with the weight of progress fixed at 10.

    Unlike all other settings of the rivals this one was chosen by success in the simulated plane,
    of 3, 10 and 30: from the records alone a weight of 1 to 3 is chosen mostly, with which it does
    far worse. It tells how well a nearest neighbour can do there.
    """

    _clocks = (10.0,)


def choose(rows: Rows, lengths: list[int], clocks: tuple[float, ...]) -> Settings:
    """Return the settings with the least error of commands, each record predicted from the others.

    It is measured on up to 600 rows, evenly spaced. The first settings if there is one record.

    Args:
        rows: of the records.
        lengths: windows to try, in rows.
        clocks: weights of time to try.
    """
    if rows.record[-1] == 0:
        return Settings(1, lengths[0], clocks[0])
    queries = np.arange(0, len(rows.row), max(len(rows.row) // _QUERIES, 1))
    others = rows.record[queries, None] != rows.record
    spread = spread_of(rows.command)
    errors: dict[Settings, float] = {}
    for length in lengths:
        features = _features(rows, length, 1.0)
        seen, time = features[:, :-1], features[:, -1:]
        by_seen, by_time = (cdist(x[queries], x, "sqeuclidean") for x in (seen, time))
        for clock in clocks:
            squared = np.where(others, by_seen + clock**2 * by_time, np.inf)
            most = min(max(_NEIGHBOURS), int(others.sum(axis=1).min()))
            found = np.argpartition(squared, most - 1, axis=1)[:, :most]
            distance = np.sqrt(np.take_along_axis(squared, found, axis=1))
            order = np.argsort(distance, axis=1)
            found, distance = (np.take_along_axis(x, order, axis=1) for x in (found, distance))
            for k in _NEIGHBOURS:
                mean = weighted(rows.command[found[:, :k]], distance[:, :k])
                error = command_error(mean, rows.command[queries], spread).mean()
                errors[Settings(k, length, clock)] = float(error)
    return min(errors, key=lambda settings: errors[settings])


def weighted(commands: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Return the means `[B, n_u]` of commands `[B, k, n_u]`, weighted by 1 / distance `[B, k]`.

    1e-6 is added to distances, so that equal observations have a weight.
    """
    weight = 1 / (distance + 1e-6)
    return (weight[..., None] * commands).sum(axis=1) / weight.sum(axis=1)[:, None]


def _features(rows: Rows, window: int, clock: float) -> np.ndarray:
    """Return each row's window and weighted progress, `[R, n]`."""
    return np.column_stack([described(windows(rows.seen, window)), clock * rows.progress])
