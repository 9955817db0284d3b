"""The runs of a study, and for each its parameters, records, cube position and seed."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv

from jaxreplay.params import Params
from jaxreplay.plane.options import SETTINGS, seed_of
from jaxreplay.plane.params import NOMINAL, PlaneParams
from jaxreplay.records import Records
from jaxreplay.study.config import SLOTS, StudyConfig
from jaxreplay.study.factors import AddedSensor, added_sensors, sigma_factors

# Records, by the simulated robot that made them; None: those of a file.
Demonstrations = Mapping[PlaneParams | None, Records]


class Runs(NamedTuple):
    """The n runs of a study, in the order of its dataset's dimensions.

    Attributes:
        values: of each factor in each run, `[n]` by name.
        position: `[n]` index into the test positions; 0 in an environment.
        repeat: `[n]`.
    """

    values: dict[str, np.ndarray]
    position: np.ndarray
    repeat: np.ndarray

    def __len__(self) -> int:
        """Return n."""
        return len(self.position)

    def of(self, which: np.ndarray) -> "Runs":
        """Return some of the runs."""
        values = {name: value[which] for name, value in self.values.items()}
        return Runs(values, self.position[which], self.repeat[which])

    @property
    def enabled(self) -> set[str]:
        """Factors with a true value in the first run; valid for the runs of one shard.

        The runs of a shard agree in all factors that are switches of sensors.
        """
        return {name for name, value in self.values.items() if len(value) and value[0]}


def runs_of(config: StudyConfig) -> Runs:
    """Return all runs of a study: its dimensions × positions, if any, × repeats."""
    counts = [len(config.axes[name]) for name in config.dims]
    counts += [max(len(config.positions), 1), config.repeats]
    grid = np.array(list(product(*map(range, counts))))
    *indices, position, repeat = grid.T
    values = {name: np.full(len(grid), value) for name, value in config.fixed.items()}
    for group, index in zip(config.dims.values(), indices, strict=True):
        values |= {name: np.array(config.axes[name])[index] for name in group}
    return Runs({name: values[name] for name in config.world.factors}, position, repeat)


def shard_size(config: StudyConfig) -> int:
    """Return how many runs are done and stored together: enough to fill the study's slots."""
    return max(SLOTS, config.slots)


def shards_of(config: StudyConfig, runs: Runs, size: int) -> list[np.ndarray]:
    """Divide runs into shards of runs that can be replayed in one batch; return their indices."""
    keys = {name: f.batch_key for name, f in config.world.factors.items() if f.batch_key}
    alike: dict[tuple, list[int]] = {}
    for k in range(len(runs)):
        key = tuple(of(runs.values[name][k], runs.repeat[k]) for name, of in keys.items())
        alike.setdefault((*key, taught_by(config, runs, k)), []).append(k)
    return [
        np.array(part[i : i + size]) for part in alike.values() for i in range(0, len(part), size)
    ]


def taught_by(config: StudyConfig, runs: Runs, k: int) -> PlaneParams | None:
    """Return the simulated robot that made the demonstrations of the k-th of these runs.

    It has the settings of the run's own robot, but is not pushed; or the nominal settings. None:
    they are in a file.
    """
    if config.demonstrations is not None:
        return None
    own = set(SETTINGS) - {"push"} if runs.values["taught"][k] == "alike" else set()
    settings = (_plain(runs.values[name][k]) if name in own else NOMINAL[name] for name in SETTINGS)
    return _robot(config.plane, tuple(settings))


@cache
def _robot(plane: PlaneParams, settings: tuple[Any, ...]) -> PlaneParams:
    """Return the constants with other settings; kept, as a study has few robots and many runs."""
    return replace(plane, **dict(zip(SETTINGS, settings, strict=True)))


def settings_of(
    config: StudyConfig, demonstrations: Demonstrations, runs: Runs
) -> tuple[Params, list[int], dict[str, np.ndarray]]:
    """Return the parameters, seeds and reset options of n runs, for :func:`jaxreplay.replay`.

    A run's seed follows from the study's seed, the index of its position (not the coordinates) and
    its repeat alone. So runs that differ in a factor have a world and a noise in common, and can be
    compared in pairs.

    Returns:
        `[n]`-batched parameters, n seeds, and options with n values each (on the plane `cube`,
        `[n, 3]`, and the robot's settings).
    """
    values, world = runs.values, config.world
    ranges = world.ranges(demonstrations[taught_by(config, runs, 0)])
    ranges |= {s.name: s.range for s in added_sensors(world.factors, runs.enabled)}
    given = {name for name, value in values.items() if value[0] is not None}
    shares = [values[name] for name in sigma_factors(given, ranges, world.groups)]
    sigma = np.stack(shares, axis=1).astype(float) * np.array(list(ranges.values()))
    params = Params(values["theta_i"], values["theta_tau"], sigma)
    # The 1 keeps them apart from the seeds of demonstrations, (study's seed, index).
    where = zip(runs.position.tolist(), runs.repeat.tolist(), strict=True)
    seeds = [seed_of(config.seed, position, repeat, 1) for position, repeat in where]
    return params, seeds, world.options(values, runs.position)


def records_of(config: StudyConfig, demonstrations: Demonstrations, runs: Runs) -> Records:
    """Return the records that the runs of one shard replay, of all demonstrations by robot.

    Sensors are added before records are chosen, so that a record's sensors do not depend on the
    choice.

    Raises:
        ValueError: fewer records than the runs ask for.
    """
    records = demonstrations[taught_by(config, runs, 0)]
    factors = config.world.factors
    for sensor in added_sensors(factors, runs.enabled):
        records = _with_sensor(records, sensor, config.seed)
    for name, factor in factors.items():
        value = runs.values[name][0]
        if factor.choose and value is not None:
            which = factor.choose(value, records.n_records, config.seed, int(runs.repeat[0]))
            records = records.subset(which)
    return records


def worlds_of(config: StudyConfig, runs: Runs, render: bool = False) -> VectorEnv:
    """Return the worlds in which the runs of one shard run; with `render`, to be looked at."""
    worlds = config.world.make(min(config.slots, len(runs)), render)
    for sensor in added_sensors(config.world.factors, runs.enabled):
        worlds = sensor.worlds(worlds)
    return worlds


def _with_sensor(records: Records, sensor: AddedSensor, seed: int) -> Records:
    """Return records with one more sensor, which has one value throughout each record."""
    sensors, commands = records.sequences()
    levels = [np.full((len(rows), 1), sensor.level(seed, i)) for i, rows in enumerate(sensors)]
    return Records.from_sequences(
        [np.hstack(pair) for pair in zip(sensors, levels, strict=True)],
        commands,
        (*records.sensor_names, sensor.name),
        records.command_names,
        records.period,
    )


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
