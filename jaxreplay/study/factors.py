"""Factors that a study can vary: those of every study, and σ of a sensor."""

import re
from collections.abc import Callable, Collection, Hashable, Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv

from jaxreplay.filter.belief import DEFAULT_JUMP, READINGS
from jaxreplay.filter.options import LAST_STEPS, STARTS
from jaxreplay.loop.rivals import controller_named
from jaxreplay.study.parse import Reader, number, one_of, probability, whole


class AddedSensor(NamedTuple):
    """A sensor that a factor adds to a world's, in demonstrations and in runs.

    Attributes:
        name: of the sensor.
        range: its highest value minus its lowest, by which σ is multiplied.
        level: maps the study's seed and a demonstration's index to the sensor's value in that
            demonstration, which is constant.
        worlds: wraps an environment so that it has the sensor.
    """

    name: str
    range: float
    level: Callable[..., float]
    worlds: Callable[[Any], VectorEnv]


class Factor(NamedTuple):
    """Something a study can vary.

    Attributes:
        default: value where the study gives none; `REQUIRED`: the study must give one. None: the
            default depends on other factors (a sensor's σ on `sigma`), or changes nothing
            (`records`, `light`).
        read: reads a value in a study's file (see `parse`).
        symbol: the name in tables and figures.
        units: of a number; empty for words and switches.
        long_name: in words.
        sensor: the sensor it adds where its value is true.
        choose: maps (value, number of records, study seed, repeat) to the records' indices.
        batch_key: maps (value, repeat) to a key; runs with equal keys can be replayed in one
            batch. None: runs with any values can.
    """

    default: Any
    read: Reader
    symbol: str
    units: str
    long_name: str
    sensor: AddedSensor | None = None
    choose: Callable[[Any, int, int, int], list[int]] | None = None
    batch_key: Callable[[Any, int], Hashable] | None = None


REQUIRED = object()


def read_records(given: Any, key: str) -> str:
    """Read how many records to draw, or which to take; see :func:`choose_records`."""
    if isinstance(given, str) and re.fullmatch(r"\d+( drawn|( \d+)*)", given):
        return given  # read before
    if isinstance(given, int) and not isinstance(given, bool):
        return f"{whole(1, 10_000)(given, key)} drawn"
    if not isinstance(given, list) or not given:
        raise ValueError(
            f"{key} must be how many records to draw, such as 6, or a list of their numbers, "
            f"such as [0, 4, 19]; got {given!r}"
        )
    which = [whole(0, 9_999)(k, f"{key}[{i}]") for i, k in enumerate(given)]
    if len(set(which)) != len(which):
        raise ValueError(f"{key} contains a record twice: {which}")
    return " ".join(map(str, which))


def read_controller(given: Any, key: str) -> str:
    """Read the name of a controller, or a user's own as "module:name"."""
    if not isinstance(given, str):
        raise ValueError(f"{key} must be a controller's name; got {given!r}")
    controller_named(given)  # before any work is done
    return given


def choose_records(value: str, n_records: int, seed: int, repeat: int) -> list[int]:
    """Return the indices of the records that a value of the factor `records` stands for.

    Args:
        value: `"6 drawn"`, or numbers such as `"0 4 19"`.
        n_records: how many records there are.
        seed: the study's seed.
        repeat: the run's repeat. Runs of one repeat draw the same records, whatever their other
            factors; each repeat draws anew.

    Raises:
        ValueError: there are fewer records than that.
    """
    first, *others = value.split()
    if others == ["drawn"]:
        if int(first) > n_records:
            raise ValueError(f"records: {first} cannot be drawn from {n_records}")
        rng = np.random.default_rng([seed, repeat, int(first)])
        return sorted(rng.choice(n_records, int(first), replace=False).tolist())
    which = [int(first), *map(int, others)]
    if max(which) >= n_records:
        raise ValueError(f"records: there is no {max(which)}; they are 0 to {n_records - 1}")
    return which


def _drawn_anew(value: str | None, repeat: int) -> Hashable:
    """Return the key of runs that replay the same records."""
    return value, repeat if value is not None and value.endswith("drawn") else None


FACTORS: dict[str, Factor] = {  # of every study
    "theta_i": Factor(
        REQUIRED, probability(1), "θ_I", "1", "probability to jump to another record"
    ),
    "theta_tau": Factor(0.05, probability(0.5), "θ_τ", "1", "probability to stay, and to skip"),
    "sigma": Factor(0.1, number(1e-6, 1e6), "σ", "1", "σ of every sensor, as a share of its range"),
    "jump": Factor(
        DEFAULT_JUMP,
        one_of(*READINGS),
        "jump",
        "",
        "reading of a jump",
        batch_key=lambda value, repeat: value,
    ),
    "start": Factor(
        STARTS[0],
        one_of(*STARTS),
        "start",
        "",
        "where in the demonstrations the filter starts",
        batch_key=lambda value, repeat: value,
    ),
    "last_steps": Factor(
        LAST_STEPS,
        whole(0, 10_000),
        "last steps",
        "1",
        "samples that count as a demonstration's end",
        batch_key=lambda value, repeat: value,
    ),
    "records": Factor(
        None,
        read_records,
        "records",
        "",
        "which of the demonstrations",
        choose=choose_records,
        batch_key=_drawn_anew,
    ),
    "controller": Factor(
        "filter",
        read_controller,
        "controller",
        "",
        "what turns observations into commands",
        batch_key=lambda value, repeat: value,
    ),
}


def added_sensors(factors: Mapping[str, Factor], enabled: Collection[str]) -> list[AddedSensor]:
    """Return the sensors that some enabled factors add."""
    return [f.sensor for name, f in factors.items() if f.sensor and name in enabled]


def sigma_of(sensors: str) -> Factor:
    """Return the factor of one sensor's σ, or of one group's."""
    return Factor(
        None, number(1e-6, 1e6), f"σ {sensors}", "1", f"σ of {sensors}, as a share of the range"
    )


def sigma_factors(
    given: Collection[str], sensors: Collection[str], groups: Mapping[str, str]
) -> list[str]:
    """Return, for each sensor, the most specific σ factor given: sensor, then group, then `sigma`.

    Args:
        given: the factors that have a value.
        sensors: their names.
        groups: the group of each sensor that is in one.
    """
    found = []
    for name in sensors:
        group = [f"sigma_{groups[name]}"] if name in groups else []
        found.append([f for f in ("sigma", *group, f"sigma_{name}") if f in given][-1])
    return found
