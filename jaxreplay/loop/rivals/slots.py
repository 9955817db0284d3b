"""What the rivals share: rows of the records, and what each slot has observed."""

from collections.abc import Callable, Iterable
from functools import wraps
from hashlib import sha256
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from jaxreplay.params import Params
from jaxreplay.records import Records

_APART = 4
_KEPT = 4  # results that `remembered` keeps
_Fitted = TypeVar("_Fitted")


class Rows(NamedTuple):
    """All rows of N records, R = Σ L_i, one after the other.

    Attributes:
        seen: N arrays, the i-th `[L_i, n_s]`: observations, divided by the sensors' ranges.
        command: `[R, n_u]` the command that followed the observation of the row, in the actuators'
            own units: that of the next row, as row t is a command and the observation after it;
            in a record's last row the command of that row.
        record: `[R]` index of the record.
        row: `[R]` index t of the row in its record.
        length: `[R]` L_i of the record.
        first: `[n_u]` mean of the records' first commands, sent before anything is observed.
        scale: `[n_s]` ranges of the sensors in the records, 1 where a sensor never changes.
        mean: `[n_s]` mean observation, divided by the ranges.
        second: rows in a second; 10 if the records' period is unknown.
        last: rows that count as a record's end, as for the filter (§ 2.2.5).
    """

    seen: list[np.ndarray]
    command: np.ndarray
    record: np.ndarray
    row: np.ndarray
    length: np.ndarray
    first: np.ndarray
    scale: np.ndarray
    mean: np.ndarray
    second: int
    last: int

    @property
    def progress(self) -> np.ndarray:
        """`[R]` the share (t + 1) / L_i of its record that a row completes."""
        return (self.row + 1) / self.length

    @property
    def apart(self) -> np.ndarray:
        """`[R]` bool, rows of every fourth record, on which settings are tried; none if N < 4."""
        return self.record % _APART == _APART - 1

    def lasting(self, seconds: Iterable[float]) -> list[int]:
        """Return how many rows last so many seconds, at least 1."""
        return [max(round(each * self.second), 1) for each in seconds]

    def within(self, command: np.ndarray) -> np.ndarray:
        """Return commands `[B, n_u]` clipped to their ranges in the records.

        A regression may extrapolate far beyond them.
        """
        return np.clip(command, self.command.min(axis=0), self.command.max(axis=0))

    @property
    def ends(self) -> np.ndarray:
        """`[R]` bool, whether a row is one of the last of its record."""
        return self.row >= self.length - self.last


def rows_of(records: Records, last: int) -> Rows:
    """Return all rows of the records, of which the last ones count as a record's end."""
    sensors, commands = records.sequences(filled=True)
    low, high = np.asarray(records.span, float)
    scale = np.where(high > low, high - low, 1.0)
    seen = [s / scale for s in sensors]
    lengths = np.array([len(s) for s in seen])
    return Rows(
        seen=seen,
        command=np.concatenate([np.concatenate([u[1:], u[-1:]]) for u in commands]).astype(float),
        record=np.repeat(np.arange(len(seen)), lengths),
        row=np.concatenate([np.arange(n) for n in lengths]),
        length=np.repeat(lengths, lengths),
        first=np.mean([u[0] for u in commands], axis=0, dtype=float),
        scale=scale,
        mean=np.concatenate(seen).mean(axis=0),
        second=10 if records.period is None else max(round(1 / records.period), 1),
        last=last,
    )


def remembered(fit: Callable[[Rows], _Fitted]) -> Callable[[Rows], _Fitted]:
    """Return a function of rows that keeps its last results: a study's shards share records."""
    kept: dict[bytes, _Fitted] = {}

    @wraps(fit)
    def fitted(rows: Rows) -> _Fitted:
        content = sha256(rows.scale.tobytes() + rows.length.tobytes() + rows.command.tobytes())
        for seen in rows.seen:
            content.update(seen.tobytes())
        key = content.digest()
        if key not in kept:
            while len(kept) >= _KEPT:
                del kept[next(iter(kept))]
            kept[key] = fit(rows)
        return kept[key]

    return fitted


def windows(seen: list[np.ndarray], length: int) -> np.ndarray:
    """Return each row's window of recent observations, `[R, length, n_s]`, the newest last.

    Before a record's first row its first observation is repeated.
    """
    padded = [np.concatenate([np.repeat(s[:1], length - 1, axis=0), s]) for s in seen]
    every = [np.lib.stride_tricks.sliding_window_view(p, length, axis=0) for p in padded]
    return np.concatenate(every).swapaxes(1, 2)


def described(window: np.ndarray) -> np.ndarray:
    """Return windows `[B, W, n_s]` as means of their parts, `[B, parts · n_s]`.

    The parts are the newest row, the 2 before it, the 4 before these and so on, up to the window's
    oldest row: what is seen now exactly, and what was seen long ago roughly.
    """
    n = window.shape[1]
    starts = np.minimum(2 ** np.arange(1, n.bit_length() + 1) - 1, n)  # rows from the newest back
    starts = np.unique(np.concatenate([[0], starts]))
    parts = [slice(n - old, n - new) for new, old in pairwise(starts)]
    return np.concatenate([window[:, part].mean(axis=1) for part in parts], axis=1)


class Recent:
    """The recent observations of B slots.

    Attributes:
        window: `[B, W, n_s]` observations divided by the sensors' ranges, the newest last. A
            missing value is the last one seen in its slot, else the mean over the records. Before
            a slot's first observation, that is repeated.
        steps: `[B]` observations made.
    """

    def __init__(self, rows: Rows, slots: int, length: int):
        """Begin B slots with windows of `length` rows."""
        self._rows = rows
        self.window = np.tile(rows.mean, (slots, length, 1))
        self.steps = np.zeros(slots, int)

    def begin(self, which: np.ndarray) -> None:
        """Forget what the slots `which`, `[B]` bool, have observed."""
        self.window[which] = self._rows.mean
        self.steps[which] = 0

    def add(self, z: np.ndarray, which: np.ndarray) -> None:
        """Add observations `[B, n_s]`, in the sensors' own units, in the slots `which`."""
        z = np.asarray(z, float) / self._rows.scale
        z = np.where(np.isnan(z), self.window[:, -1], z)
        moved = np.concatenate([self.window[:, 1:], z[:, None]], axis=1)
        moved = np.where((self.steps == 0)[:, None, None], z[:, None], moved)
        self.window[which] = moved[which]
        self.steps[which] += 1


class Lasting:
    """How long a condition has lasted in each of B slots."""

    def __init__(self, slots: int, steps: int):
        """Count in B slots; a condition lasts when it has held for `steps` steps in a row."""
        self._count, self._steps = np.zeros(slots, int), steps

    def begin(self, which: np.ndarray) -> None:
        """Start counting anew in the slots `which`, `[B]` bool."""
        self._count[which] = 0

    def add(self, holds: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Count a step in the slots `which`; return where the condition `[B]` lasts, `[B]` bool."""
        self._count[which] = np.where(holds, self._count + 1, 0)[which]
        return self._count >= self._steps


class FromRecent:
    """What controllers share that predict commands from recent observations.

    Attributes:
        command: `[B, n_u]` the commands to send next; at first the mean of the records' first.
    """

    def __init__(self, rows: Rows, slots: int, window: int):
        """Begin B slots with windows of so many rows."""
        self._rows = rows
        self._recent = Recent(rows, slots, window)
        self._at_end = Lasting(slots, rows.second)
        self.command = np.tile(rows.first, (slots, 1))

    def begin(self, which: np.ndarray, params: Params) -> None:
        """Begin new replays in the slots `which`, `[B]` bool."""
        self._recent.begin(which)
        self._at_end.begin(which)
        self.command[which] = self._rows.first


def command_error(predicted: np.ndarray, command: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return the absolute error of commands `[…, n_u]` in units of their spread `[n_u]`, `[…]`.

    Absolute, not squared: the squared error favours means of commands that robots can only switch.
    """
    return np.abs((predicted - command) / spread).mean(axis=-1)


def spread_of(command: np.ndarray) -> np.ndarray:
    """Return the standard deviations of commands `[R, n_u]`, `[n_u]`, 1 where one is constant."""
    spread = command.std(axis=0)
    return np.where(spread > 1e-9 * (1 + np.abs(command).max(axis=0)), spread, 1.0)
