"""The time between rows of episodes, checked, and made the same in all."""

import warnings
from numbers import Real
from typing import NamedTuple

import numpy as np

from jaxreplay.recordings.formats.recording import Episode

EVEN = 0.01  # how far a step may be off the median, as a share of it; also two rates that are one


class Rate(NamedTuple):
    """The rate of an episode: its period in s (None if unknown), and whether its rows need times.

    Attributes:
        period: time between rows in s; None if unknown.
        even: whether every step is within 1 % of the period.
    """

    period: float | None
    even: bool


def at_one_rate(
    episodes: list[Episode], period: float | None
) -> tuple[list[Episode], float | None]:
    """Return episodes with the same time between rows, and that time in s; None if unknown.

    It is `period`, or else that of the first episode that has one. An episode off it by more than
    1 % is resampled, with a warning: observations linearly, commands with their previous value.

    Raises:
        ValueError: times do not increase, or their steps are uneven and no period is given.
    """
    if period is not None and not (isinstance(period, Real) and 0 < period < np.inf):
        raise ValueError(f"period must be a positive number of seconds; got {period!r}")
    rates = [_rate(episode, uneven=period is not None) for episode in episodes]
    known = [rate.period for rate in rates if rate.period is not None]
    if not known:
        return episodes, period
    target = known[0] if period is None else period
    off = [
        rate.period is not None and not (rate.even and abs(rate.period / target - 1) <= EVEN)
        for rate in rates
    ]
    if any(off):
        i = off.index(True)
        warnings.warn(
            f"{sum(off)} of {len(off)} episodes resampled to {target:g} s between rows, the first "
            f"{episodes[i].where} from {rates[i].period:g} s: observations linearly, commands with "
            "their previous value",
            stacklevel=4,
        )
    return [
        _resampled(episode, rate.period, target) if moved and rate.period else episode
        for episode, rate, moved in zip(episodes, rates, off, strict=True)
    ], target


def _rate(episode: Episode, uneven: bool) -> Rate:
    """Return the rate of an episode; its steps may be uneven where that is allowed."""
    time = episode.time
    if time is None or len(time) < 2:
        return Rate(episode.period, True)
    steps = np.diff(time)
    if len(wrong := np.flatnonzero(~(steps > 0))):
        t = wrong[0]
        raise ValueError(
            f"{episode.where}: time goes from {time[t]} to {time[t + 1]} s in rows {t} to {t + 1} "
            "(from 0); times must increase; cut or sort the rows"
        )
    median = float(np.median(steps))
    far = np.flatnonzero(np.abs(steps / median - 1) > EVEN)
    if len(far) and not uneven:
        t = far[0]
        raise ValueError(
            f"{episode.where}: rows {t} and {t + 1} (from 0) are {steps[t]:.6g} s apart, most "
            f"{median:.6g} s; give a period in s to resample to, such as {median:.3g}"
        )
    # The mean is more exact than the median, where times are rounded; 6 digits, so that 0.1 is 0.1.
    mean = float(f"{(time[-1] - time[0]) / len(steps):.6g}")
    if episode.period is not None and abs(mean / episode.period - 1) <= EVEN:
        mean = episode.period
    return Rate(median if len(far) else mean, not len(far))


def _resampled(episode: Episode, period: float, target: float) -> Episode:
    n, m = len(episode.observations), len(episode.actions)
    time = np.arange(n) * period if episode.time is None else episode.time - episode.time[0]
    near = 1e-3 * target  # times are rounded, LeRobot's to float32
    grid = np.arange(int((time[-1] + near) / target) + 1) * target
    seen = [np.interp(grid, time, column) for column in episode.observations.T]
    last = np.searchsorted(time[:m], grid[: len(grid) - (n - m)] + near, side="right") - 1
    return episode._replace(
        observations=np.stack(seen, axis=1), actions=episode.actions[last], time=None, period=target
    )
