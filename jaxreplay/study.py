"""A study: a config turned into runs, and the runs into one labelled dataset."""

import hashlib
import json
import platform
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from jaxreplay.audit import audit
from jaxreplay.config import FACTORS, ConfigError, StudyConfig
from jaxreplay.params import Params
from jaxreplay.plane.demonstrator import DEMONSTRATED, TESTED, facing, record
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, SENSOR_RANGES, PlaneParams
from jaxreplay.records import Records
from jaxreplay.replay import Replays, replay
from jaxreplay.store import claimed, manifest_of, read_manifest, read_shard, write_shard

if TYPE_CHECKING:
    from jaxreplay.workers import RunEach

OUTCOMES = ("S", "Fs", "Fg", "Fb")  # as in figure 3
STALLS = ("fixed", "cyclic", "slow")
SLOTS = 56  # worlds that advance together
SHARD = 56  # runs that are kept together once all are finished; the first of them is audited


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
    try:
        records = Records.load(path)
    except ValueError as error:
        raise ConfigError(str(error)) from None
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
    return records


class Runs(NamedTuple):
    """The n runs of a study, in the order of its dataset's dimensions.

    Attributes:
        values: for each factor, its value in each run, `[n]`.
        position: `[n]` index into the test positions.
        repeat: `[n]`.
    """

    values: dict[str, np.ndarray]
    position: np.ndarray
    repeat: np.ndarray

    def __len__(self) -> int:
        """How many."""
        return len(self.position)

    def of(self, which: np.ndarray) -> "Runs":
        """Some of them."""
        values = {name: value[which] for name, value in self.values.items()}
        return Runs(values, self.position[which], self.repeat[which])


def runs_of(config: StudyConfig) -> Runs:
    """All runs of a study: every combination of its axes × test positions × repeats."""
    grid = list(product(*config.axes.values(), range(len(TESTED)), range(config.repeats)))
    *columns, position, repeat = (np.array(column) for column in zip(*grid, strict=True))
    values = {name: np.full(len(grid), value) for name, value in config.fixed.items()}
    values |= dict(zip(config.axes, columns, strict=True))
    return Runs({name: values[name] for name in FACTORS}, position, repeat)


def setting(config: StudyConfig, runs: Runs) -> tuple[Params, list[int], dict[str, np.ndarray]]:
    """What :func:`jaxreplay.replay.replay` needs for runs: parameters, seeds and options.

    A run's seed follows from the study's seed, its factors' values, its position and repeat: it
    is the same in whatever study the run stands, and at whatever place.
    """
    values = runs.values
    params = Params(
        theta_i=values["theta_i"],
        theta_tau=values["theta_tau"],
        sigma=values["sigma"][:, None] * np.array(SENSOR_RANGES),
    )
    seeds = []
    for k in range(len(runs)):
        what = {name: value[k].item() for name, value in values.items()}
        key = json.dumps([config.seed, what, int(runs.position[k]), int(runs.repeat[k])])
        seeds.append(int.from_bytes(hashlib.sha256(key.encode()).digest()[:8]))
    options = {name: values[name] for name in SETTINGS}
    options["cube"] = facing(TESTED[runs.position])
    return params, seeds, options


def outcomes(replays: Replays) -> np.ndarray:
    """`[n]` how replays in the plane ended, as in figure 3; empty for those that go on.

    S: the cube is held and lifted when the replay ends. Fs: not ended within the time limit.
    Fg: ended without the cube. Fb: left the area.
    """
    success = replays.info.get("is_success", np.zeros(len(replays.ending), bool))
    completed = np.where(success, "S", "Fg")
    ways = [replays.ending == way for way in ("terminated", "completed", "truncated")]
    return np.select(ways, ["Fb", completed, "Fs"], "")


def shards_of(runs: Runs) -> list[np.ndarray]:
    """The runs, as indices, cut into shards that share a reading of a jump."""
    jumps = runs.values["jump"]
    alike = [np.flatnonzero(jumps == jump) for jump in dict.fromkeys(jumps)]
    return [part[i : i + SHARD] for part in alike for i in range(0, len(part), SHARD)]


def run_study(
    config: StudyConfig,
    folder: str | Path,
    progress: Callable[[np.ndarray], None] = lambda outcome: None,
    workers: "Callable[[], AbstractContextManager[RunEach]] | None" = None,
) -> xr.Dataset:
    """Run what a folder does not hold yet of a study, shard by shard.

    Args:
        config: the study.
        folder: made if absent; what else lies in it is left alone.
        progress: called after each control step, or each shard that a worker did, with the
            outcome of every run of the study, empty for those to come.
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
    manifest = manifest_of(config, records, SHARD)
    runs = runs_of(config)
    outcome = np.full(len(runs), "", "<U2")
    with claimed(folder, manifest):
        todo = {}
        for k, which in enumerate(shards_of(runs)):
            held = read_shard(folder, k, manifest, _ABOUT)
            if held is None:
                todo[k] = which
            else:
                outcome[which] = held.outcome.values.astype("<U2")
        if workers is None:
            for k, which in todo.items():

                def tell(so_far: Replays, which=which):
                    outcome[which] = outcomes(so_far)
                    progress(outcome)

                write_shard(folder, k, manifest, _run(config, records, runs.of(which), tell))
        elif todo:
            calls = {k: (config, records, runs.of(which), manifest) for k, which in todo.items()}
            with workers() as run_each:
                for k, shard in run_each(_run_elsewhere, calls):
                    write_shard(folder, k, manifest, shard)
                    outcome[todo[k]] = shard.outcome.values
                    progress(outcome)
    return open_study(folder)


def _run_elsewhere(
    config: StudyConfig, records: Records, runs: Runs, manifest: dict[str, Any]
) -> xr.Dataset:
    """In a worker, which may have been set up otherwise."""
    for what, here in (
        ("jaxreplay", version("jaxreplay")),
        ("dtype", str(jax.dtypes.canonicalize_dtype(np.float64))),
    ):
        if here != manifest[what]:
            raise ConfigError(
                f"a worker on {platform.node()} has {what} {here}; this study needs "
                f"{manifest[what]}"
            )
    return _run(config, records, runs)


def _run(
    config: StudyConfig,
    records: Records,
    runs: Runs,
    progress: Callable[[Replays], None] = lambda so_far: None,
) -> xr.Dataset:
    params, seeds, options = setting(config, runs)
    env = PlaneVectorEnv(min(SLOTS, len(runs)))
    jump = str(runs.values["jump"][0])
    replays = replay(records, params, env, jump, seeds, options, [0], progress)
    outcome = outcomes(replays)
    results = {
        "outcome": outcome,
        "stall": replays.info["stall"],
        "alignment_error": np.where(outcome == "S", 1e3 * replays.info["alignment_error"], np.nan),
        "duration": replays.steps * env.params.control_period,
        "log_evidence": replays.log_evidence,
        "widened": replays.widened,
        "total_variation": np.full(len(runs), np.nan),
        "command_error": np.full(len(runs), np.nan),
    }
    first = jax.tree.map(lambda x: x[0], params)
    found = audit(records, first, jump, np.array(replays.observations[0]))
    results["total_variation"][0], results["command_error"][0] = found
    return xr.Dataset({name: ("run", values) for name, values in results.items()})


_ABOUT = {
    "outcome": {"long_name": "outcome of the run", "values": " ".join(OUTCOMES)},
    "stall": {"long_name": "what an Fs is", "values": " ".join(STALLS)},
    "alignment_error": {"units": "mm", "long_name": "alignment error"},
    "duration": {"units": "s", "long_name": "run duration"},
    "log_evidence": {"units": "1", "long_name": "log p(Z_1:t) of the run"},
    "widened": {"units": "1", "long_name": "steps done again in a wider window"},
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
    path = held["demonstrations"]
    return StudyConfig(**held | {"demonstrations": Path(path) if path else None})


def open_study(folder: str | Path) -> xr.Dataset:
    """The dataset of a study, wholly read, as far as it is finished.

    Returns:
        Variables `outcome` (S, Fs, Fg or Fb), `stall` (fixed, cyclic or slow for an Fs),
        `alignment_error` (mm, NaN unless S), `duration` (s), `log_evidence`,
        `widened` (steps done again in a wider window), and, of the first run of each shard,
        `total_variation` and `command_error` (see :mod:`jaxreplay.audit`), over the axes of the
        study, `position` and `repeat`. Runs that are missing have an empty outcome and NaN.

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
    for k, which in enumerate(shards_of(runs)):
        held = read_shard(folder, k, manifest, _ABOUT)
        for name in _ABOUT if held is not None else ():
            results[name][which] = held[name].values.astype(results[name].dtype)
    dims = (*config.axes, "position", "repeat")
    shape = (*map(len, config.axes.values()), len(TESTED), config.repeats)
    return xr.Dataset(
        {name: (dims, results[name].reshape(shape), about) for name, about in _ABOUT.items()},
        coords={name: (name, list(values), _about(name)) for name, values in config.axes.items()}
        | {
            "position": np.arange(len(TESTED)),
            "repeat": np.arange(config.repeats),
            "cube_x": ("position", TESTED[:, 0], {"units": "m", "long_name": "cube, ahead"}),
            "cube_y": ("position", TESTED[:, 1], {"units": "m", "long_name": "cube, to the left"}),
        },
        attrs={"manifest": json.dumps(manifest)},
    )
