"""The TOML file that describes a study, strictly checked."""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from jaxreplay.factors import FACTORS, MUST, number, sigma_factors, whole
from jaxreplay.plane.demonstrator import TESTED
from jaxreplay.plane.options import unknown
from jaxreplay.plane.params import SENSOR_NAMES, SENSOR_RANGES

SLOTS = 56  # worlds that advance together, unless a study says otherwise
# Where a cube can be laid in the experimental area, clear of the robot: m ahead, m to the left.
CUBE_X, CUBE_Y = (0.2, 0.7), (-0.3, 0.3)


class ConfigError(ValueError):
    """A user's mistake in a study's description; the message names file, key and remedy."""


@dataclass(frozen=True)
class StudyConfig:
    """A study: every combination of its axes × test positions × repeats.

    Attributes:
        axes: for each factor that varies, its values, in the file's order.
        fixed: the value of every other factor.
        zip: groups of axes that move together.
        positions: where cubes stand, (x, y) in m from the robot's start.
        repeats: runs at each test position.
        seed: of the demonstrations and the runs, a non-negative integer.
        slots: worlds that advance together.
        demonstrations: file of records to replay; recorded by the demonstrator when None.
    """

    axes: dict[str, tuple]
    fixed: dict[str, Any]
    zip: tuple[tuple[str, ...], ...] = ()
    positions: tuple[tuple[float, float], ...] = tuple(map(tuple, TESTED.tolist()))
    repeats: int = 3
    seed: int = 0
    slots: int = SLOTS
    demonstrations: Path | None = None

    @property
    def dims(self) -> dict[str, tuple[str, ...]]:
        """The dimensions of the axes, each named for the first of those that move along it."""
        group_of = {name: group for group in self.zip for name in group}
        groups = [group_of.get(name, (name,)) for name in self.axes]
        return {group[0]: group for group in groups}


def load_config(path: str | Path, changes: Sequence[str] = ()) -> StudyConfig:
    """Read and check a study's description.

    Args:
        path: a TOML file.
        changes: what replaces the file's, each `KEY=VALUE` with the key dotted as in the file,
            such as `"axis.theta_i.logspace=[-1, -3, 5]"`; paths in them are not relative to it.

    Raises:
        ConfigError: no such file, not TOML, an unknown key, a value of the wrong type or out
            of range.
    """
    path = Path(path)
    given = _loaded(path)
    if isinstance(given.get("demonstrations"), str):
        given["demonstrations"] = str(path.parent / given["demonstrations"])
    try:
        for change in changes:
            _change(given, change)
        return _parse(given)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def tuned_changes(path: str | Path) -> list[str]:
    """The parameters that jaxreplay tune saved in a file, as changes for :func:`load_config`.

    Raises:
        ConfigError: no such file, not TOML, not such parameters, or those of other sensors than
            the plane's.
    """
    given = _loaded(Path(path))
    sigma = given.get("sigma")
    if given.keys() != {"theta_i", "theta_tau", "sigma"} or not isinstance(sigma, dict):
        raise ConfigError(
            f"{path}: must hold theta_i, theta_tau and a table sigma, as jaxreplay tune saves them"
        )
    if sorted(sigma) != sorted(SENSOR_NAMES):
        raise ConfigError(
            f"{path}: its sensors are {', '.join(sigma)}; the plane has {', '.join(SENSOR_NAMES)}"
        )
    values = {name: given[name] for name in ("theta_i", "theta_tau")}
    for name, full in zip(SENSOR_NAMES, SENSOR_RANGES, strict=True):
        try:
            values[f"sigma_{name}"] = number(0, float("inf"))(sigma[name], f"sigma.{name}") / full
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from None
    return [f"{name}={value!r}" for name, value in values.items()]


def _loaded(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is not TOML: {error}") from None


def _change(given: dict, change: str):
    key, equals, text = change.partition("=")
    *path, last = key.strip().split(".")
    if not equals or not last:
        raise ValueError(f"--set {change}: give KEY=VALUE, such as axis.theta_i=[0.1, 0.01]")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()  # a word without its quotes
    # A factor has either a value or an axis, and an axis is spaced in one way.
    if path[:1] == ["axis"]:
        given.pop((*path, last)[1], None)
    elif not path and isinstance(given.get("axis"), dict):
        given["axis"].pop(last, None)
    for name in path:
        if not isinstance(given.get(name), dict):
            given[name] = {}
        given = given[name]
    if last in ("linspace", "logspace"):
        given.clear()
    given[last] = value


def _parse(given: dict) -> StudyConfig:
    axis = given.pop("axis", {})
    if not isinstance(axis, dict):
        raise ValueError(f"axis must be a table, [axis]; got {axis!r}")
    others = {
        "zip": lambda value, key: _zip(value, key, axes),
        "positions": _positions,
        "repeats": whole(1, 10_000),
        "seed": whole(0, 2**63 - 1),
        "slots": whole(1, 4096),
        "demonstrations": _file,
    }
    _known(given, (*FACTORS, *others, "axis"), "")
    _known(axis, tuple(FACTORS), "axis.")
    axes = {
        name: tuple(_values(value, f"axis.{name}", FACTORS[name].read))
        for name, value in axis.items()
    }
    fixed = {}
    for name, factor in FACTORS.items():
        if name in given and name in axes:
            raise ValueError(f"{name} and axis.{name} are both given; keep one")
        if name in given:
            fixed[name] = factor.read(given[name], name)
        elif name not in axes:
            if factor.default is MUST:
                raise ValueError(f"{name} is missing; give one value, or a list as axis.{name}")
            fixed[name] = factor.default
    said = {*axes, *(name for name, value in fixed.items() if value is not None)}
    used = sigma_factors(said)
    if "light" in axes or fixed.get("light"):
        used.append("sigma")
    for name in axes:
        if name.startswith("sigma") and name not in used:
            raise ValueError(f"axis.{name} has no effect: each of its sensors has a σ of its own")
    config = StudyConfig(
        axes, fixed, **{key: read(given[key], key) for key, read in others.items() if key in given}
    )
    for group in config.dims.values():  # of axes that move together, one may stand still
        together = list(zip(*(axes[name] for name in group), strict=True))
        _distinct(together, ", ".join(f"axis.{name}" for name in group))
    return config


def _known(given: dict, allowed: tuple[str, ...], prefix: str):
    for key in given:
        if key not in allowed:
            known = [f"{prefix}{name}" for name in allowed]
            raise ValueError(f"unknown key {unknown(prefix + key, known)}")


def _distinct(values: list, key: str) -> tuple:
    """All of them, if none stands there twice."""
    if len(set(values)) != len(values):
        twice = next(value for value in values if values.count(value) > 1)
        raise ValueError(f"{key} holds a value twice: {twice}")
    return tuple(values)


def _values(given, key: str, read: Callable[[Any, str], Any]) -> list:
    """A list as it stands, or spaced evenly, or spaced evenly between exponents of 10."""
    if isinstance(given, dict):
        given = _spaced(given, key)
    elif not isinstance(given, list) or not given:
        hint = "" if isinstance(given, list) else f"; write [{given!r}]"
        raise ValueError(f"{key} must be a list of at least one value; got {given!r}{hint}")
    return [read(value, f"{key}[{i}]") for i, value in enumerate(given)]


def _spaced(given: dict, key: str) -> list[float]:
    _known(given, ("linspace", "logspace"), f"{key}.")
    if len(given) != 1:
        raise ValueError(f"{key} needs a list, or one of linspace and logspace; got {given!r}")
    ((way, span),) = given.items()
    what = "exponent" if way == "logspace" else "value"
    if not isinstance(span, list) or len(span) != 3:
        raise ValueError(f"{key}.{way} must be [first {what}, last {what}, how many]; got {span!r}")
    first, last = (number(-300, 300)(v, f"{key}.{way}[{i}]") for i, v in enumerate(span[:2]))
    count = whole(1, 10_000)(span[2], f"{key}.{way}[2]")
    # Rounded, that the value written and the value meant are one.
    values = [float(f"{value:.12g}") for value in np.linspace(first, last, count)]
    return [float(f"{10.0**v:.12g}") for v in values] if way == "logspace" else values


def _zip(given, key: str, axes: dict[str, tuple]) -> tuple[tuple[str, ...], ...]:
    if not isinstance(given, list) or not all(isinstance(g, list) and len(g) > 1 for g in given):
        raise ValueError(
            f'{key} must list groups of axes, such as [["motor_unit", "battery"]]; got {given!r}'
        )
    names = [name for group in given for name in group]
    for name in names:
        if name not in axes:
            raise ValueError(f"{key} names {name!r}, which is no axis here ({', '.join(axes)})")
    _distinct(names, key)
    for group in given:
        lengths = [len(axes[name]) for name in group]
        if len(set(lengths)) > 1:
            raise ValueError(
                f"{key}: {', '.join(group)} have {lengths} values; give as many of each"
            )
    return tuple(map(tuple, given))


def _positions(given, key: str) -> tuple[tuple[float, float], ...]:
    """Where cubes stand: a list of [x, y], or a table of x and y of which all pairs are meant."""
    x, y = number(*CUBE_X), number(*CUBE_Y)
    if isinstance(given, dict):
        _known(given, ("x", "y"), f"{key}.")
        if len(given) != 2:
            raise ValueError(f"{key} needs x and y, or a list of [x, y]; got {given!r}")
        xs, ys = (_values(given[k], f"{key}.{k}", read) for k, read in (("x", x), ("y", y)))
        return _distinct(list(product(xs, ys)), key)
    if not isinstance(given, list) or not given:
        raise ValueError(f"{key} must be a list of [x, y] in m; got {given!r}")
    pairs = []
    for i, pair in enumerate(given):
        if not isinstance(pair, list) or len(pair) != 2:
            raise ValueError(f"{key}[{i}] must be [x, y] in m; got {pair!r}")
        pairs.append(
            tuple(
                read(v, f"{key}[{i}][{k}]")
                for k, (read, v) in enumerate(zip((x, y), pair, strict=True))
            )
        )
    return _distinct(pairs, key)


def _file(given, key: str) -> Path:
    if not isinstance(given, str):
        raise ValueError(f"{key} must be a file's path; got {given!r}")
    if not Path(given).is_file():
        raise ValueError(f"{key}: there is no file {given}")
    return Path(given)
