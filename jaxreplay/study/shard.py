"""A shard: runs of a study replayed in one batch, and their results as a dataset."""

import platform
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any

import jax
import numpy as np
import xarray as xr

from jaxreplay.errors import ConfigError
from jaxreplay.filter.options import Options, options_of
from jaxreplay.loop.audit import audit
from jaxreplay.loop.replay import LostWarning, Replays, replay
from jaxreplay.loop.rivals import controller_named
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.runs import Demonstrations, Runs, records_of, settings_of, worlds_of
from jaxreplay.study.store import RESULTS_FORMAT

AUDITED = 56  # one run in this many is filtered again without windows


def run_shard(
    config: StudyConfig,
    demonstrations: Demonstrations,
    runs: Runs,
    which: np.ndarray,
    progress: Callable[[Replays], None] = lambda so_far: None,
) -> xr.Dataset:
    """Do the runs of one shard.

    Args:
        config: the study.
        demonstrations: by the robot that made them.
        runs: the n runs.
        which: `[n]` their indices in the study.
        progress: called with the results so far after every control step.

    Returns:
        The variables of :func:`jaxreplay.study.dataset.variables_of` along `run`.
    """
    filtered = runs.values["controller"] == "filter"
    audited = np.flatnonzero((which % AUDITED == 0) & filtered).tolist()
    replays = replays_of(config, demonstrations, runs, audited, progress)
    world = config.world
    results = {
        "outcome": world.outcome(replays),
        **world.results(replays),
        "log_evidence": replays.log_evidence,
        "widened": replays.widened,
        "dropped": replays.dropped,
        "total_variation": np.full(len(runs), np.nan),
        "command_error": np.full(len(runs), np.nan),
    }
    for k in audited:
        one = runs.of(np.array([k]))
        params = jax.tree.map(lambda x: x[0], settings_of(config, demonstrations, one)[0])
        found = audit(
            records_of(config, demonstrations, one),
            params,
            how_of(one),
            np.array(replays.observations[k]),
        )
        results["total_variation"][k], results["command_error"][k] = found
    return xr.Dataset({name: ("run", values) for name, values in results.items()})


def run_shard_elsewhere(
    shared: tuple[StudyConfig, Demonstrations, dict[str, Any]], runs: Runs, which: np.ndarray
) -> xr.Dataset:
    """Do the runs of one shard in a worker, whose installation may differ.

    Raises:
        ConfigError: the worker would give other results than the study's manifest promises.
    """
    config, demonstrations, manifest = shared
    for what, here in (
        ("format", RESULTS_FORMAT),
        ("dtype", str(jax.dtypes.canonicalize_dtype(np.float64))),
    ):
        if here != manifest[what]:
            raise ConfigError(
                f"a worker on {platform.node()} has {what} {here}; this study needs "
                f"{manifest[what]}"
            )
    return run_shard(config, demonstrations, runs, which)


def replays_of(
    config: StudyConfig,
    demonstrations: Demonstrations,
    runs: Runs,
    keep: Sequence[int] = (),
    progress: Callable[[Replays], None] = lambda so_far: None,
) -> Replays:
    """Replay runs that can be done in one batch; arguments as in :func:`run_shard`.

    `keep` lists the runs whose observations are returned.
    """
    params, seeds, options = settings_of(config, demonstrations, runs)
    worlds = worlds_of(config, runs)
    with closing(worlds), config.world.failures(), warnings.catch_warnings():
        # A study's outcomes say which runs failed.
        warnings.simplefilter("ignore", LostWarning)
        return replay(
            records_of(config, demonstrations, runs),
            params,
            worlds,
            seeds,
            **how_of(runs)._asdict(),
            options=options,
            controller=controller_named(runs.values["controller"][0]),
            keep=keep,
            progress=progress,
        )


def how_of(runs: Runs) -> Options:
    """Return reading of a jump, start and end of the runs of one shard, which agree in them."""
    return options_of(**{name: runs.values[name][0] for name in Options._fields})
