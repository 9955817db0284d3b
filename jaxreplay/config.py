"""The TOML file that describes a study, strictly checked."""

import difflib
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from jaxreplay.filter import PREDICTIONS


class ConfigError(ValueError):
    """A user's mistake in a study's description; the message names file, key and remedy."""


@dataclass(frozen=True)
class StudyConfig:
    """A study: every combination of its axes × test positions × repeats.

    Attributes:
        theta_i: θ_I, the values to compare.
        jump: readings of a jump to compare.
        theta_tau: θ_τ.
        sigma: σ of every sensor, as a share of its range.
        repeats: runs at each test position.
        seed: of the demonstrations and the runs, a non-negative integer.
        demonstrations: file of records to replay; recorded by the demonstrator when None.
    """

    theta_i: tuple[float, ...]
    jump: tuple[str, ...] = ("same_tau",)
    theta_tau: float = 0.05
    sigma: float = 0.1
    repeats: int = 3
    seed: int = 0
    demonstrations: Path | None = None


AXES = ("theta_i", "jump")


def load_config(path: str | Path) -> StudyConfig:
    """Read and check a study's description.

    Raises:
        ConfigError: no such file, not TOML, an unknown key, a value of the wrong type or out
            of range.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            given = tomllib.load(file)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is not TOML: {error}") from None
    try:
        return _parse(given, path.parent)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def _parse(given: dict, folder: Path) -> StudyConfig:
    axis = given.pop("axis", {})
    if not isinstance(axis, dict):
        raise ConfigError(f"axis must be a table, [axis]; got {axis!r}")
    scalars = [f.name for f in fields(StudyConfig) if f.name not in AXES]
    _known(given, [*scalars, "axis"], "")
    _known(axis, AXES, "axis.")
    if "theta_i" not in axis:
        raise ConfigError("axis.theta_i is missing; give a list of values, or logspace")

    values = {
        "theta_i": tuple(
            _number(v, f"axis.theta_i[{i}]", 0, 1)
            for i, v in enumerate(_values(axis["theta_i"], "axis.theta_i"))
        )
    }
    if "jump" in axis:
        values["jump"] = tuple(_list(axis["jump"], "axis.jump"))
        for i, jump in enumerate(values["jump"]):
            if jump not in tuple(PREDICTIONS):
                raise ConfigError(
                    f"axis.jump[{i}] must be one of {list(PREDICTIONS)}; got {jump!r}"
                )
    for key in AXES:
        if len(set(values.get(key, ()))) != len(values.get(key, ())):
            raise ConfigError(f"axis.{key} holds a value twice: {list(values[key])}")
    if "theta_tau" in given:
        values["theta_tau"] = _number(given["theta_tau"], "theta_tau", 0, 0.5)
    if "sigma" in given:
        values["sigma"] = _number(given["sigma"], "sigma", 1e-6, 1e6)
    for key, low, high in (("repeats", 1, 10_000), ("seed", 0, 2**63 - 1)):
        if key in given:
            values[key] = _integer(given[key], key, low, high)
    if "demonstrations" in given:
        if not isinstance(given["demonstrations"], str):
            raise ConfigError(
                f"demonstrations must be a file's path; got {given['demonstrations']!r}"
            )
        values["demonstrations"] = folder / given["demonstrations"]
        if not values["demonstrations"].is_file():
            raise ConfigError(f"demonstrations: there is no file {values['demonstrations']}")
    return StudyConfig(**values)


def _known(given: dict, allowed: list[str] | tuple[str, ...], prefix: str):
    for key in given:
        if key not in allowed:
            near = difflib.get_close_matches(key, allowed, n=1)
            hint = f"; did you mean {prefix}{near[0]}?" if near else ""
            if key in AXES and not prefix:
                hint = "; it belongs under [axis]"
            raise ConfigError(
                f"unknown key {prefix}{key}{hint} (known: {', '.join(prefix + a for a in allowed)})"
            )


def _values(given, key: str) -> list:
    """A list as it stands, or as `logspace = [first exponent, last exponent, how many]`."""
    if not isinstance(given, dict):
        return _list(given, key)
    _known(given, ("logspace",), f"{key}.")
    span = given.get("logspace")
    if not isinstance(span, list) or len(span) != 3:
        raise ConfigError(
            f"{key}.logspace must be [first exponent, last exponent, how many]; got {span!r}"
        )
    first, last = (_number(v, f"{key}.logspace[{i}]", -300, 300) for i, v in enumerate(span[:2]))
    count = _integer(span[2], f"{key}.logspace[2]", 1, 10_000)
    return [float(10.0**exponent) for exponent in np.linspace(first, last, count)]


def _list(given, key: str) -> list:
    if not isinstance(given, list) or not given:
        hint = "" if isinstance(given, list | dict) else f"; write [{given!r}]"
        raise ConfigError(f"{key} must be a list of at least one value; got {given!r}{hint}")
    return given


def _number(given, key: str, low: float, high: float) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise ConfigError(f"{key} must be a number; got {given!r}")
    if not low <= given <= high:
        raise ConfigError(f"{key} must be in [{low:g}, {high:g}]; got {_short(given)}")
    return float(given)


def _integer(given, key: str, low: int, high: int) -> int:
    if isinstance(given, bool) or not isinstance(given, int) or not low <= given <= high:
        raise ConfigError(f"{key} must be a whole number from {low} to {high}; got {_short(given)}")
    return given


def _short(given) -> str:
    return repr(given) if len(repr(given)) <= 40 else repr(given)[:40] + "…"
