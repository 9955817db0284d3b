"""The runs of a study: what each is told."""

import hashlib
import json
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv

from jaxreplay.config import StudyConfig
from jaxreplay.factors import FACTORS, chosen_records, sigma_of_sensors
from jaxreplay.params import Params
from jaxreplay.plane.demonstrator import facing
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.light import Lit, lit
from jaxreplay.plane.options import SETTINGS
from jaxreplay.records import Records


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
    counts = [len(config.axes[name]) for name in config.dims]
    grid = np.array(list(product(*map(range, (*counts, len(config.positions), config.repeats)))))
    *indices, position, repeat = grid.T
    values = {name: np.full(len(grid), value) for name, value in config.fixed.items()}
    for group, index in zip(config.dims.values(), indices, strict=True):
        values |= {name: np.array(config.axes[name])[index] for name in group}
    return Runs({name: values[name] for name in FACTORS}, position, repeat)


def setting(config: StudyConfig, runs: Runs) -> tuple[Params, list[int], dict[str, np.ndarray]]:
    """What :func:`jaxreplay.replay.replay` needs for runs: parameters, seeds and options.

    A run's seed follows from the study's seed, its factors' values, its position and repeat: it
    is the same in whatever study the run stands, and at whatever place.
    """
    values = runs.values
    sigma = sigma_of_sensors(values)
    if len(runs) and values["light"][0]:
        sigma = np.column_stack([sigma, values["sigma"].astype(float)])  # its range is 1
    params = Params(values["theta_i"], values["theta_tau"], sigma)
    seeds = []
    for k in range(len(runs)):
        said = {name: _plain(value[k]) for name, value in values.items() if value[k] is not None}
        key = json.dumps([config.seed, said, int(runs.position[k]), int(runs.repeat[k])])
        seeds.append(int.from_bytes(hashlib.sha256(key.encode()).digest()[:8]))
    options = {name: values[name] for name in SETTINGS}
    options["cube"] = facing(np.array(config.positions)[runs.position])
    return params, seeds, options


def records_of(config: StudyConfig, records: Records, runs: Runs) -> Records:
    """The demonstrations that runs of one shard replay.

    Those drawn are drawn anew for each repeat, and alike for all other runs.

    Raises:
        ValueError: there are not as many.
    """
    told = runs.values["records"][0]
    if runs.values["light"][0]:
        records = lit(records, config.seed)
    if told is None:
        return records
    return records.subset(chosen_records(told, records.n_records, config.seed, int(runs.repeat[0])))


def worlds_for(runs: Runs, slots: int) -> VectorEnv:
    """What runs of one shard run in."""
    worlds = PlaneVectorEnv(min(slots, len(runs)))
    return Lit(worlds) if runs.values["light"][0] else worlds


def shards_of(runs: Runs, size: int) -> list[np.ndarray]:
    """The runs, as indices, cut into shards that share a reading of a jump, sensors and records."""
    alike: dict[tuple, list[int]] = {}
    shared = [runs.values[name] for name in ("jump", "light", "records")]
    for k, key in enumerate(zip(*shared, strict=True)):
        drawn = key[-1] is not None and key[-1].endswith("drawn")
        alike.setdefault((*key, runs.repeat[k] if drawn else None), []).append(k)
    return [
        np.array(part[i : i + size]) for part in alike.values() for i in range(0, len(part), size)
    ]


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
