"""The TOML file that describes a study, strictly checked."""

import difflib
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxreplay.filter import PREDICTIONS
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import PlaneParams


class ConfigError(ValueError):
    """A user's mistake in a study's description; the message names file, key and remedy."""


class Factor(NamedTuple):
    """Something a study can vary: what it may be, and what it is when nothing is said.

    Attributes:
        default: None where it must be given.
        allowed: least and greatest of a number, or all values.
        symbol: how tables and figures call it.
        units: of a number.
        long_name: in words.
    """

    default: Any
    allowed: tuple
    symbol: str
    units: str
    long_name: str

    @property
    def numeric(self) -> bool:
        """Whether it is a number between two others."""
        return self.units != ""


_PLANE = PlaneParams()
FACTORS = {
    "theta_i": Factor(None, (0, 1), "θ_I", "1", "probability to jump to another record"),
    "theta_tau": Factor(0.05, (0, 0.5), "θ_τ", "1", "probability to stay, and to skip"),
    "sigma": Factor(0.1, (1e-6, 1e6), "σ", "1", "σ of every sensor, as a share of its range"),
    "jump": Factor("same_tau", tuple(PREDICTIONS), "jump", "", "reading of a jump"),
    "dithering": Factor(
        _PLANE.dithering, (False, True), "dithering", "", "temporal dithering of the tracks"
    ),
    "motor_unit": Factor(
        _PLANE.motor_unit, SETTINGS["motor_unit"], "motor unit", "m/s", "what track speeds round to"
    ),
    "battery": Factor(
        _PLANE.battery,
        SETTINGS["battery"],
        "battery",
        "1",
        "voltage, as a share of a full battery's",
    ),
    "sensor_noise": Factor(
        _PLANE.sensor_noise,
        SETTINGS["sensor_noise"],
        "sensor noise",
        "1",
        "factor on the sensors' noise",
    ),
}


@dataclass(frozen=True)
class StudyConfig:
    """A study: every combination of its axes × test positions × repeats.

    Attributes:
        axes: for each factor that varies, its values, in the file's order.
        fixed: the value of every other factor.
        repeats: runs at each test position.
        seed: of the demonstrations and the runs, a non-negative integer.
        demonstrations: file of records to replay; recorded by the demonstrator when None.
    """

    axes: dict[str, tuple]
    fixed: dict[str, Any]
    repeats: int = 3
    seed: int = 0
    demonstrations: Path | None = None


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
    _known(given, (*FACTORS, "repeats", "seed", "demonstrations", "axis"), "")
    _known(axis, tuple(FACTORS), "axis.")
    axes = {name: _axis(axis[name], name) for name in axis}
    fixed = {}
    for name, factor in FACTORS.items():
        if name in given and name in axes:
            raise ConfigError(f"{name} and axis.{name} are both given; keep one")
        if name in given:
            fixed[name] = _value(given[name], name, factor)
        elif name not in axes:
            if factor.default is None:
                raise ConfigError(f"{name} is missing; give one value, or a list as axis.{name}")
            fixed[name] = factor.default

    others = {}
    for key, low, high in (("repeats", 1, 10_000), ("seed", 0, 2**63 - 1)):
        if key in given:
            others[key] = _integer(given[key], key, low, high)
    if "demonstrations" in given:
        if not isinstance(given["demonstrations"], str):
            raise ConfigError(
                f"demonstrations must be a file's path; got {given['demonstrations']!r}"
            )
        others["demonstrations"] = folder / given["demonstrations"]
        if not others["demonstrations"].is_file():
            raise ConfigError(f"demonstrations: there is no file {others['demonstrations']}")
    return StudyConfig(axes, fixed, **others)


def _known(given: dict, allowed: tuple[str, ...], prefix: str):
    for key in given:
        if key not in allowed:
            near = difflib.get_close_matches(key, allowed, n=1)
            hint = f"; did you mean {prefix}{near[0]}?" if near else ""
            raise ConfigError(
                f"unknown key {prefix}{key}{hint} (known: {', '.join(prefix + a for a in allowed)})"
            )


def _axis(given, name: str) -> tuple:
    key = f"axis.{name}"
    values = tuple(
        _value(v, f"{key}[{i}]", FACTORS[name]) for i, v in enumerate(_values(given, key))
    )
    if len(set(values)) != len(values):
        raise ConfigError(f"{key} holds a value twice: {list(values)}")
    return values


def _values(given, key: str) -> list:
    """A list as it stands, or spaced evenly, or spaced evenly between exponents of 10."""
    if not isinstance(given, dict):
        return _list(given, key)
    _known(given, ("linspace", "logspace"), f"{key}.")
    if len(given) != 1:
        raise ConfigError(f"{key} needs a list, or one of linspace and logspace; got {given!r}")
    ((way, span),) = given.items()
    what = "exponent" if way == "logspace" else "value"
    if not isinstance(span, list) or len(span) != 3:
        raise ConfigError(
            f"{key}.{way} must be [first {what}, last {what}, how many]; got {span!r}"
        )
    first, last = (_number(v, f"{key}.{way}[{i}]", -300, 300) for i, v in enumerate(span[:2]))
    count = _integer(span[2], f"{key}.{way}[2]", 1, 10_000)
    # Rounded, that the value written and the value meant are one.
    values = [float(f"{value:.12g}") for value in np.linspace(first, last, count)]
    return [float(f"{10.0**v:.12g}") for v in values] if way == "logspace" else values


def _list(given, key: str) -> list:
    if not isinstance(given, list) or not given:
        hint = "" if isinstance(given, list | dict) else f"; write [{given!r}]"
        raise ConfigError(f"{key} must be a list of at least one value; got {given!r}{hint}")
    return given


def _value(given, key: str, factor: Factor):
    if factor.numeric:
        return _number(given, key, *factor.allowed)
    if type(given) is not type(factor.default) or given not in factor.allowed:
        allowed = ", ".join(
            str(a).lower() if a in (True, False) else repr(a) for a in factor.allowed
        )
        raise ConfigError(f"{key} must be one of {allowed}; got {given!r}")
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
