"""What a study will cost, measured on a few of its runs."""

import time
from typing import NamedTuple

import numpy as np
import psutil

from jaxreplay.config import StudyConfig
from jaxreplay.records import Records
from jaxreplay.runs import Runs, runs_of, shards_of
from jaxreplay.study import replays_of
from jaxreplay.tracker import LANES, windows_for

SAMPLE = 8  # runs
WORLD = 500_000  # bytes of one world: its space and the noise drawn for it; measured


class Cost(NamedTuple):
    """What a study takes.

    Attributes:
        seconds: of one core, for one run.
        memory: of one process at its largest, bytes.
    """

    seconds: float
    memory: int


def estimate(config: StudyConfig, records: Records) -> Cost:
    """Do a few runs from all over a study, twice: the first time may have to compile."""
    runs = runs_of(config)
    sample = runs.of(np.unique(np.linspace(0, len(runs) - 1, SAMPLE).astype(int)))
    for _ in range(2):
        began = time.process_time()
        for which in shards_of(sample, SAMPLE):
            replays_of(config, records, sample.of(which))
        seconds = (time.process_time() - began) / len(sample)
    return Cost(seconds, _memory(config, records, runs))


def _memory(config: StudyConfig, records: Records, runs: Runs) -> int:
    """This process's, and what the slots add that were not filled."""
    held = psutil.Process().memory_info().rss
    lane = 8 * records.n_records * sum(w or records.longest for w in windows_for(records))
    slots = min(config.slots, len(runs))
    lanes = -(-slots // LANES) * LANES
    return held + (lanes - LANES) * lane + max(slots - SAMPLE, 0) * WORLD
