"""The cost of a study, measured on a few of its runs."""

import time
from typing import NamedTuple

import numpy as np
import psutil

from jaxreplay.loop.tracker import LANES, windows_for
from jaxreplay.records import Records
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.runs import Demonstrations, Runs, runs_of, shards_of
from jaxreplay.study.shard import replays_of

SAMPLE = 8  # runs
WORLD = 500_000  # bytes of one world: of the plane, its space and its noise; measured


class Cost(NamedTuple):
    """The time and memory that a study takes.

    Attributes:
        seconds: of one core for one run.
        memory: of one process at its largest, in bytes.
    """

    seconds: float
    memory: int


def estimate(config: StudyConfig, demonstrations: Demonstrations) -> Cost:
    """Measure a few runs spread over a study, twice: the first time may compile."""
    runs = runs_of(config)
    sample = runs.of(np.unique(np.linspace(0, len(runs) - 1, SAMPLE).astype(int)))
    seconds = 0.0
    for _ in range(2):
        began = time.process_time()
        for which in shards_of(config, sample, SAMPLE):
            replays_of(config, demonstrations, sample.of(which))
        seconds = (time.process_time() - began) / len(sample)
    return Cost(seconds, _memory(config, next(iter(demonstrations.values())), runs))


def _memory(config: StudyConfig, records: Records, runs: Runs) -> int:
    """Return the bytes of this process, and of the slots that the sample did not fill."""
    used = psutil.Process().memory_info().rss
    lane = 8 * records.n_records * sum(w or records.longest for w in windows_for(records))
    slots = min(config.slots, len(runs))
    lanes = -(-slots // LANES) * LANES
    return used + (lanes - LANES) * lane + max(slots - SAMPLE, 0) * WORLD
