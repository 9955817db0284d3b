"""A study run in a folder, shard by shard, continuing where it was stopped."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxreplay.loop.replay import Replays
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.dataset import variables_of
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.open import open_study
from jaxreplay.study.progress import Progress
from jaxreplay.study.runs import runs_of, shard_size, shards_of
from jaxreplay.study.shard import run_shard, run_shard_elsewhere
from jaxreplay.study.store import (
    ShardError,
    check_format,
    claim,
    locked,
    manifest_of,
    read_shard,
    write_shard,
)

# Takes a function, an argument that all calls share, and each call's own arguments by key; runs the
# calls in workers and yields (key, result) as each ends.
RunEach = Callable[[Callable, Any, dict[int, tuple]], Iterator[tuple[int, Any]]]


def run_study(
    config: StudyConfig,
    folder: str | Path,
    progress: Callable[[np.ndarray, np.ndarray], None] | None = None,
    workers: Callable[[], AbstractContextManager[RunEach]] | None = None,
) -> xr.Dataset:
    """Run a study, or the part of it that its folder does not contain yet.

    Args:
        config: the study.
        folder: made if absent; other files in it are left alone.
        progress: called first with what the folder contains, then after each control step, or
            after each shard that a worker did. Its arguments are, for all n runs of the study, the
            outcomes `[n]`, empty for runs not ended, and the duration so far `[n]` (on the plane
            in s, of an environment in steps).
            None: it is printed (see :mod:`jaxreplay.study.progress`).
        workers: opens processes to run shards in (see :mod:`jaxreplay.study.workers`); None: this
            process. On processors of the same kind the stored results are identical, byte for
            byte, wherever they were computed.

    Returns:
        The dataset, as :func:`jaxreplay.open_study` returns it.

    Raises:
        ConfigError: the config's demonstrations do not fit; the folder contains another study, or
            one of another results format; another process is running in it.
        OSError: the folder cannot be written; workers cannot be reached, or were lost. Finished
            shards are kept.
    """
    folder, world, runs = Path(folder), config.world, runs_of(config)
    check_format(folder)
    # Those of a file are checked before anything is written, those of the teacher made once locked.
    records = demonstrations(config, folder) if config.demonstrations is not None else None
    outcome, duration = np.full(len(runs), "", "<U2"), np.zeros(len(runs))
    progress = progress or Progress(len(runs), world.time_limit(), world.outcomes, world.speed)
    variables = variables_of(world.outcomes, world.variables)
    with locked(folder):
        records = records or demonstrations(config, folder)
        manifest = claim(folder, manifest_of(config, records, shard_size(config)))
        missing = {}
        for k, which in enumerate(shards_of(config, runs, manifest["shard"])):
            try:
                shard = read_shard(folder, k, manifest, variables, len(which))
            except ShardError:
                shard = None
            if shard is None:
                missing[k] = which
            else:
                outcome[which] = shard.outcome.values.astype("<U2")
                duration[which] = shard.duration.values
        progress(outcome, duration)
        if workers is None:
            for k, which in missing.items():

                def show(so_far: Replays, which: np.ndarray = which) -> None:
                    outcome[which] = world.outcome(so_far)
                    duration[which] = so_far.steps * world.step
                    progress(outcome, duration)

                shard = run_shard(config, records, runs.of(which), which, show)
                write_shard(folder, k, manifest, shard)
        elif missing:
            calls = {k: (runs.of(which), which) for k, which in missing.items()}
            shared = config, records, manifest
            with workers() as run_each:
                for k, shard in run_each(run_shard_elsewhere, shared, calls):
                    write_shard(folder, k, manifest, shard)
                    outcome[missing[k]] = shard.outcome.values
                    duration[missing[k]] = shard.duration.values
                    progress(outcome, duration)
    return open_study(folder)
