"""The tape: the nearest record, played blindly."""

import numpy as np

from jaxreplay.filter.options import Options
from jaxreplay.loop.controller import Observed
from jaxreplay.loop.rivals.slots import Recent, rows_of
from jaxreplay.params import Params
from jaxreplay.records import Records

_WAIT = 0.5  # s
_WAIT_ROWS = 5  # where the records' period is unknown


class Tape:
    """Play one record's commands open loop, as a teach-and-playback robot arm does.

    For the first 0.5 s (5 rows if the records' period is unknown; fewer if a record is shorter) it
    sends the commands of the first record's first rows. That assumes that robots stand still, or
    move alike, at first. Then it picks the record whose observation in that row is nearest, each
    sensor divided by its range, and sends its remaining commands. It ends when it has sent the
    last.
    """

    def __init__(self, records: Records, params: Params, options: Options):
        """Begin B replays; of the `[B]`-batched params only B is used, of the options none."""
        self._rows = rows_of(records, options.counted)
        self._commands = [u.astype(float) for u in records.sequences()[1]]
        self._lengths = np.array([len(u) for u in self._commands])
        rows = _WAIT_ROWS if records.period is None else max(round(_WAIT / records.period), 1)
        self._wait = min(rows, self._lengths.min())
        self._start = np.array([s[self._wait - 1] for s in self._rows.seen])  # [N, n_s]
        slots = len(params.theta_i)
        self._recent = Recent(self._rows, slots, 1)
        self._record = np.zeros(slots, int)

    @property
    def command(self) -> np.ndarray:
        """`[B, n_u]` the commands to send next; after a record's end, its last."""
        at = np.minimum(self._recent.steps, self._lengths[self._record] - 1)
        return np.array([self._commands[i][t] for i, t in zip(self._record, at, strict=True)])

    def begin(self, which: np.ndarray, params: Params) -> None:
        """Begin new replays in the slots `which`."""
        self._recent.begin(which)
        self._record[which] = 0

    def observe(self, z: np.ndarray, which: np.ndarray) -> Observed:
        """Count a step in the slots `which`; pick their records when they have waited."""
        self._recent.add(z, which)
        for b in np.flatnonzero(which & (self._recent.steps == self._wait)):
            away = ((self._start - self._recent.window[b, -1]) ** 2).sum(axis=1)
            self._record[b] = away.argmin()
        ended = self._recent.steps >= self._lengths[self._record]
        return Observed(ended.astype(float))
