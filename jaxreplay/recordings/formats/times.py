"""The time between rows of episodes, checked, and made the same in all."""

import warnings
from typing import NamedTuple

import numpy as np

from jaxreplay.recordings.formats.recording import Episode
from jaxreplay.records.arrays import check_period

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
) -> tuple[list[Episode], list[float], float | None]:
    """Return episodes whose rows are evenly spaced, their ratios to one period, and that in s.

    The period is the one given, or else that of the first episode that has one, or None if none
    has. A ratio is this period divided by the episode's own; 1 where they differ by less than 1 %.
    Episodes of uneven steps are resampled here, observations linearly and commands with their
    previous value; the others are to be resampled once their rows are aligned.

    Raises:
        ValueError: times do not increase, or their steps are uneven and no period is given.
    """
    check_period(period)
    rates = [_rate(episode, uneven=period is not None) for episode in episodes]
    known = [rate.period for rate in rates if rate.period is not None]
    if not known:
        return episodes, [1.0] * len(episodes), period
    target = known[0] if period is None else period
    even = [
        episode if rate.even or not rate.period else _resampled(episode, target)
        for episode, rate in zip(episodes, rates, strict=True)
    ]
    ratios = [target / r.period if r.even and r.period else 1.0 for r in rates]
    ratios = [1.0 if abs(ratio - 1) <= EVEN else ratio for ratio in ratios]
    off = [i for i, ratio in enumerate(ratios) if ratio != 1]
    if off and period is None:
        i = off[0]
        warnings.warn(
            f"{len(off)} of {len(episodes)} episodes resampled to {target:g} s between rows, the "
            f"first {episodes[i].where} from {rates[i].period:g} s",
            stacklevel=4,
        )
    return even, ratios, target


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


def _resampled(episode: Episode, target: float) -> Episode:
    """Return an episode that has times with rows `target` s apart."""
    assert episode.time is not None
    n, m = len(episode.observations), len(episode.actions)
    time = episode.time - episode.time[0]
    near = 1e-3 * target  # times are rounded, LeRobot's to float32
    grid = np.arange(int((time[-1] + near) / target) + 1) * target
    seen = [np.interp(grid, time, column) for column in episode.observations.T]
    last = np.searchsorted(time[:m], grid[: len(grid) - (n - m)] + near, side="right") - 1
    return episode._replace(
        observations=np.stack(seen, axis=1), actions=episode.actions[last], time=None, period=target
    )
