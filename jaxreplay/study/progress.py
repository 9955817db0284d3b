"""The progress of a running study."""

import sys
import time
from collections.abc import Iterable

import numpy as np
from tqdm import tqdm

_UNIT = "% of the simulated time"


class Progress:
    """Shows the progress of a study: a bar on a terminal, else a line for every tenth of the work.

    Work is counted in simulated seconds (of an environment, in steps): runs that advance together
    end at about the same time, so a count of ended runs would stand still and then leap. A run that
    has not ended is expected to last as long as the mean of those ended, or a quarter longer than
    it has lasted if that is more, but no longer than the time limit. While none has ended, each is
    expected to last until the time limit, and no time left is shown.

    An instance is called as `run_study` calls its `progress`.
    """

    def __init__(self, total: int, time_limit: float, outcomes: Iterable[str], speed: str):
        """Begin to show the progress of a study.

        Args:
            total: runs.
            time_limit: longest duration of a run.
            outcomes: how a run can end.
            speed: what is done per second, in words.
        """
        self._total, self._time_limit = total, time_limit
        self._outcomes, self._speed = tuple(outcomes), speed
        self._began, self._share, self._shown = None, 0.0, 0
        self._bar = tqdm(
            total=1.0, bar_format=f"{{percentage:3.0f}} {_UNIT}|{{bar:10}}|{{desc}}", disable=None
        )

    def __call__(self, outcome: np.ndarray, duration: np.ndarray) -> None:
        """Show the outcomes so far, empty for runs not ended, and the runs' durations."""
        ended, now = outcome != "", time.monotonic()
        done, simulated = int(ended.sum()), float(duration.sum())
        expected = _expected(ended, duration, self._time_limit)
        share = 1.0 if done == self._total else min(simulated / expected, 0.99)
        self._share = max(self._share, share)  # an estimate that rises does not undo work
        if self._began is None:  # runs of an earlier call count as done, but not for the speed
            self._began, self._shown = (now, simulated), int(10 * self._share)
        since, already = self._began
        rate = (simulated - already) / max(now - since, 1e-9)
        left = ""
        if 0 < done < self._total and rate > 0:
            left = f", {tqdm.format_interval((expected - simulated) / rate)} left"
        counts = ", ".join(f"{name} {np.sum(outcome == name)}" for name in self._outcomes)
        line = f"{done} of {self._total} runs{left}: {counts}; {rate:.0f} {self._speed}"
        self._bar.n = self._share
        self._bar.set_description_str(f" {line}", refresh=False)
        self._bar.update(0)
        if self._bar.disable and int(10 * self._share) > self._shown:
            self._shown = int(10 * self._share)
            print(f"{100 * self._share:.0f} {_UNIT}: {line}", file=sys.stderr)
        if done == self._total:
            self._bar.close()


def _expected(ended: np.ndarray, duration: np.ndarray, time_limit: float) -> float:
    """Return the seconds that all runs are expected to last, from those that have ended."""
    usual = duration[ended].mean() if ended.any() else time_limit
    # The shortest runs end first, so that the others soon outlast the mean: 1.25 keeps some left.
    running = np.minimum(np.maximum(1.25 * duration, usual), time_limit)
    return float(np.where(ended, duration, running).sum())
