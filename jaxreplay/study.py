"""A study: a config turned into runs, and the runs into one labelled dataset."""

import hashlib
import json
import platform
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import xarray as xr

from jaxreplay.audit import audit
from jaxreplay.config import SLOTS, ConfigError, StudyConfig
from jaxreplay.factors import FACTORS, chosen_records
from jaxreplay.plane.demonstrator import DEMONSTRATED, record
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams
from jaxreplay.records import Records
from jaxreplay.replay import Replays, replay
from jaxreplay.runs import Runs, records_of, runs_of, setting, shards_of, worlds_for
from jaxreplay.store import claimed, manifest_of, read_manifest, read_shard, write_shard

if TYPE_CHECKING:
    from jaxreplay.workers import RunEach

OUTCOMES = ("S", "Fs", "Fg", "Fb")  # as in figure 3
STALLS = ("fixed", "cyclic", "slow")
SHARD = SLOTS  # runs that are kept together once all are finished, or as many as there are slots
AUDITED = 56  # one run in so many is filtered again without windows


def loaded(path: Path) -> Records:
    """The records in a file.

    Raises:
        ConfigError: it does not hold any.
    """
    try:
        return Records.load(path)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def demonstrations(config: StudyConfig, folder: Path) -> Records:
    """The records to replay: the file the config names, or the study's own, made if absent.

    Raises:
        ConfigError: the file does not hold records of the plane's sensors and commands.
    """
    plane = PlaneParams()
    # Named for all that made them, so that none made otherwise is taken for them.
    made_by = json.dumps([version("jaxreplay"), config.seed, DEMONSTRATED.tolist(), asdict(plane)])
    own = folder / f"demonstrations_{hashlib.sha256(made_by.encode()).hexdigest()[:12]}.npz"
    path = config.demonstrations or own
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        try:
            records, _ = record(plane, DEMONSTRATED, config.seed)
        except RuntimeError as error:
            raise ConfigError(f"{error}; choose another seed than {config.seed}") from None
        records.save(path)
    records = loaded(path)
    for held, wanted, what in (
        (records.sensor_names, SENSOR_NAMES, "sensors"),
        (records.command_names, COMMAND_NAMES, "commands"),
    ):
        if held != wanted:
            raise ConfigError(
                f"{path}: its {what} are {', '.join(held)}; the plane has {', '.join(wanted)}, "
                "and can replay no others"
            )
    if records.period not in (None, plane.control_period):
        raise ConfigError(
            f"{path}: its rows are {records.period} s apart; the plane's control period is "
            f"{plane.control_period} s: resample them"
        )
    for told in config.axes.get("records", (config.fixed.get("records"),)):
        if told is not None:
            try:
                chosen_records(told, records.n_records, config.seed, 0)
            except ValueError as error:
                raise ConfigError(f"{error} (of {path})") from None
    return records


def outcomes(replays: Replays) -> np.ndarray:
    """`[n]` how replays in the plane ended, as in figure 3; empty for those that go on.

    S: the cube is held and lifted when the replay ends. Fs: not ended within the time limit.
    Fg: ended without the cube. Fb: left the area.
    """
    success = replays.info.get("is_success", np.zeros(len(replays.ending), bool))
    completed = np.where(success, "S", "Fg")
    ways = [replays.ending == way for way in ("terminated", "completed", "truncated")]
    return np.select(ways, ["Fb", completed, "Fs"], "")


def run_study(
    config: StudyConfig,
    folder: str | Path,
    progress: Callable[[np.ndarray, np.ndarray], None] = lambda outcome, duration: None,
    workers: "Callable[[], AbstractContextManager[RunEach]] | None" = None,
) -> xr.Dataset:
    """Run what a folder does not hold yet of a study, shard by shard.

    Args:
        config: the study.
        folder: made if absent; what else lies in it is left alone.
        progress: called after each control step, or each shard that a worker did, with the
            outcome of every run of the study, empty for those to come, and the seconds that it
            lasted so far.
        workers: what opens processes to run shards in (see :mod:`jaxreplay.workers`); None runs
            them here. A shard comes to the same bytes wherever it is run, on processors of one
            kind.

    Returns:
        What :func:`open_study` gives.

    Raises:
        ConfigError: the demonstrations named by the config do not fit; the folder holds
            another study; another process is at work in it.
        OSError: the folder cannot be written; workers cannot be reached, or were lost. What was
            finished before is kept.
    """
    folder = Path(folder)
    records = demonstrations(config, folder)
    manifest = manifest_of(config, records, shard_size(config))
    runs = runs_of(config)
    outcome, duration = np.full(len(runs), "", "<U2"), np.zeros(len(runs))
    with claimed(folder, manifest):
        todo = {}
        for k, which in enumerate(shards_of(runs, manifest["shard"])):
            held = read_shard(folder, k, manifest, _ABOUT)
            if held is None:
                todo[k] = which
            else:
                outcome[which] = held.outcome.values.astype("<U2")
                duration[which] = held.duration.values
        progress(outcome, duration)
        if workers is None:
            for k, which in todo.items():

                def tell(so_far: Replays, which=which):
                    outcome[which] = outcomes(so_far)
                    duration[which] = so_far.steps * PlaneParams().control_period
                    progress(outcome, duration)

                shard = _run(config, records, runs.of(which), which, tell)
                write_shard(folder, k, manifest, shard)
        elif todo:
            calls = {k: (runs.of(which), which) for k, which in todo.items()}
            with workers() as run_each:
                for k, shard in run_each(_run_elsewhere, (config, records, manifest), calls):
                    write_shard(folder, k, manifest, shard)
                    outcome[todo[k]] = shard.outcome.values
                    duration[todo[k]] = shard.duration.values
                    progress(outcome, duration)
    return open_study(folder)


def replays_of(
    config: StudyConfig,
    records: Records,
    runs: Runs,
    keep: Sequence[int] = (),
    progress: Callable[[Replays], None] = lambda so_far: None,
) -> Replays:
    """Do some runs of a study, which share a reading of a jump and the records they replay.

    Args:
        config: the study.
        records: all its demonstrations.
        runs: n of its runs.
        keep: indices of those whose observations are wanted.
        progress: called after every control step.
    """
    params, seeds, options = setting(config, runs)
    env = worlds_for(runs, config.slots)
    jump = str(runs.values["jump"][0])
    theirs = records_of(config, records, runs)
    return replay(theirs, params, env, jump, seeds, options, keep, progress)


def shard_size(config: StudyConfig) -> int:
    """Runs of a study that are kept together: enough to fill its slots."""
    return max(SHARD, config.slots)


def _run_elsewhere(
    shared: tuple[StudyConfig, Records, dict[str, Any]], runs: Runs, which: np.ndarray
) -> xr.Dataset:
    """In a worker, which may have been set up otherwise."""
    config, records, manifest = shared
    for what, here in (
        ("jaxreplay", version("jaxreplay")),
        ("dtype", str(jax.dtypes.canonicalize_dtype(np.float64))),
    ):
        if here != manifest[what]:
            raise ConfigError(
                f"a worker on {platform.node()} has {what} {here}; this study needs "
                f"{manifest[what]}"
            )
    return _run(config, records, runs, which)


def _run(
    config: StudyConfig,
    records: Records,
    runs: Runs,
    which: np.ndarray,
    progress: Callable[[Replays], None] = lambda so_far: None,
) -> xr.Dataset:
    """Some runs of a study that make a shard, and which they are."""
    audited = np.flatnonzero(which % AUDITED == 0)
    replays = replays_of(config, records, runs, audited, progress)
    outcome = outcomes(replays)
    results = {
        "outcome": outcome,
        "stall": replays.info["stall"],
        "alignment_error": np.where(outcome == "S", 1e3 * replays.info["alignment_error"], np.nan),
        "duration": replays.steps * PlaneParams().control_period,
        "log_evidence": replays.log_evidence,
        "widened": replays.widened,
        "dropped": replays.dropped,
        "total_variation": np.full(len(runs), np.nan),
        "command_error": np.full(len(runs), np.nan),
    }
    for k in audited:
        one = runs.of(np.array([k]))
        params = jax.tree.map(lambda x: x[0], setting(config, one)[0])
        theirs, jump = records_of(config, records, one), str(one.values["jump"][0])
        found = audit(theirs, params, jump, np.array(replays.observations[k]))
        results["total_variation"][k], results["command_error"][k] = found
    return xr.Dataset({name: ("run", values) for name, values in results.items()})


_ABOUT = {
    "outcome": {"long_name": "outcome of the run", "values": " ".join(OUTCOMES)},
    "stall": {"long_name": "what an Fs is", "values": " ".join(STALLS)},
    "alignment_error": {"units": "mm", "long_name": "alignment error"},
    "duration": {"units": "s", "long_name": "run duration"},
    "log_evidence": {"units": "1", "long_name": "log p(Z_1:t) of the run"},
    "widened": {"units": "1", "long_name": "steps done again in a wider window"},
    "dropped": {"units": "bit", "long_name": "log2 p of the likeliest state that windows dropped"},
    "total_variation": {"units": "1", "long_name": "largest error of the belief, by windows"},
    "command_error": {"units": "1", "long_name": "… of a command, as a share of its range"},
}
_TEXT = {"outcome": "<U2", "stall": "<U6"}


def _about(name: str) -> dict[str, str]:
    factor = FACTORS[name]
    return {"long_name": factor.long_name} | ({"units": factor.units} if factor.numeric else {})


def config_of(dataset: xr.Dataset) -> StudyConfig:
    """The config that a dataset came from."""
    return _config(json.loads(dataset.attrs["manifest"]))


def _config(manifest: dict) -> StudyConfig:
    held = dict(manifest["config"])
    held["axes"] = {name: tuple(values) for name, values in held["axes"].items()}
    unsaid = {name: None for name in FACTORS if name not in held["axes"]}
    held["fixed"] = unsaid | held["fixed"]
    held |= {n: tuple(map(tuple, held[n])) for n in ("zip", "positions") if n in held}
    path = held["demonstrations"]
    return StudyConfig(**held | {"demonstrations": Path(path) if path else None})


def open_study(folder: str | Path) -> xr.Dataset:
    """The dataset of a study, wholly read, as far as it is finished.

    Returns:
        Variables `outcome` (S, Fs, Fg or Fb), `stall` (fixed, cyclic or slow for an Fs),
        `alignment_error` (mm, NaN unless S), `duration` (s), `log_evidence`,
        `widened` (steps done again in a wider window), `dropped` (log2 of the likeliest state
        that windows let go), and, of one run in 56, `total_variation` and `command_error` (see
        :mod:`jaxreplay.audit`), over the axes of the study, `position` and `repeat`. Axes that
        move together share the dimension of the first. Runs that are missing have an empty
        outcome and NaN.

    Raises:
        FileNotFoundError: there is no study in the folder.
        ValueError: its manifest is truncated, or not one of a study.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    config = _config(manifest)
    runs = runs_of(config)
    results = {
        name: np.full(len(runs), "" if name in _TEXT else np.nan, _TEXT.get(name, float))
        for name in _ABOUT
    }
    for k, which in enumerate(shards_of(runs, manifest["shard"])):
        held = read_shard(folder, k, manifest, _ABOUT)
        for name in _ABOUT if held is not None else ():
            results[name][which] = held[name].values.astype(results[name].dtype)
    dims = (*config.dims, "position", "repeat")
    cubes = np.array(config.positions)
    coords = {
        name: (dim, list(config.axes[name]), _about(name))
        for dim, group in config.dims.items()
        for name in group
    }
    shape = (*(len(config.axes[dim]) for dim in config.dims), len(cubes), config.repeats)
    return xr.Dataset(
        {name: (dims, results[name].reshape(shape), about) for name, about in _ABOUT.items()},
        coords=coords
        | {
            "position": np.arange(len(cubes)),
            "repeat": np.arange(config.repeats),
            "cube_x": ("position", cubes[:, 0], {"units": "m", "long_name": "cube, ahead"}),
            "cube_y": ("position", cubes[:, 1], {"units": "m", "long_name": "cube, to the left"}),
        },
        attrs={"manifest": json.dumps(manifest)},
    )
