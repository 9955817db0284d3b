"""The progress of a running study."""

import sys
import time

import numpy as np
from tqdm import tqdm

from jaxreplay.study.dataset import OUTCOMES


class Progress:
    """Shows the progress of a study: a bar on a terminal, else a line for every tenth of the runs.

    An instance is called as `run_study` calls its `progress`.
    """

    def __init__(self, total: int):
        """Begin to show the progress of `total` runs."""
        self._total, self._began, self._shown = total, None, 0
        self._bar = tqdm(
            total=total,
            bar_format="{n} of {total} runs [{elapsed}<{remaining}]{postfix}",
            disable=None,
        )

    def __call__(self, outcome: np.ndarray, duration: np.ndarray) -> None:
        """Show the outcomes so far, empty for runs not ended, and the runs' seconds."""
        done = int(np.sum(outcome != ""))
        simulated, now = float(duration.sum()), time.monotonic()
        if self._began is None:  # runs of an earlier call count as done, but not for the speed
            self._began = now, simulated
            self._bar.initial, self._shown = done, 10 * done // self._total
        since, already = self._began
        counts = ", ".join(f"{name} {np.sum(outcome == name)}" for name in OUTCOMES)
        rate = (simulated - already) / max(now - since, 1e-9)
        line = f"{counts}; {rate:.0f} simulated s a second"
        self._bar.n = done
        self._bar.set_postfix_str(line, refresh=False)
        self._bar.update(0)
        if self._bar.disable and 10 * done // self._total > self._shown:
            self._shown = 10 * done // self._total
            left = (now - since) * (self._total - done) / max(done - self._bar.initial, 1)
            print(f"{done} of {self._total} runs: {line}, {left:.0f} s left", file=sys.stderr)
        if done == self._total:
            self._bar.close()
