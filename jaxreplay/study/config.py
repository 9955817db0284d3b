"""The description of a study, read from a TOML file and strictly checked."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from jaxreplay.errors import ConfigError
from jaxreplay.machine import read_toml
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import SENSOR_NAMES, SENSOR_RANGES, PlaneParams
from jaxreplay.plane.positions import TESTED
from jaxreplay.study import parse
from jaxreplay.study.factors import FACTORS, REQUIRED, added_sensors, sigma_factors

SLOTS = 56  # worlds that advance together by default


@dataclass(frozen=True)
class StudyConfig:
    """A study: every combination of its axes' values × test positions × repeats.

    `StudyConfig(axes={"theta_i": [0.1, 0.01]})` is complete: what is not given has the default
    that a TOML file's has, and all values are checked and converted as a file's are.

    Attributes:
        axes: the values of each factor that varies, in the file's order.
        fixed: the value of every other factor.
        zip: groups of axes that move together: value k of one goes with value k of the others.
        positions: of the cube in the test runs, (x, y) in m from the robot's start.
        repeats: runs at each position.
        seed: of the demonstrations and the runs, a non-negative integer.
        slots: worlds that advance together.
        demonstrations: file of records to replay; None: the study's own, made by the teacher.
        plane: the constants of robot, cube, sensors and area. Those that are factors (such as
            `motor_unit`) are given as factors.

    Raises:
        ConfigError: an unknown name, or a value of a wrong type or out of range.
    """

    axes: Mapping[str, Any] = field(default_factory=dict)
    fixed: Mapping[str, Any] = field(default_factory=dict)
    zip: tuple[tuple[str, ...], ...] = ()
    positions: tuple[tuple[float, float], ...] = tuple(map(tuple, TESTED.tolist()))
    repeats: int = 3
    seed: int = 0
    slots: int = SLOTS
    demonstrations: Path | None = None
    plane: PlaneParams = field(default_factory=PlaneParams)

    def __post_init__(self):
        try:
            self._check()
        except ConfigError:
            raise
        except ValueError as error:
            raise ConfigError(str(error)) from None

    def _check(self) -> None:
        """Check every value, and convert it to what it means."""

        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        given = {f.name: parse.plain(getattr(self, f.name)) for f in fields(self)}
        for name, prefix in (("axes", "axis."), ("fixed", "")):
            if not isinstance(given[name], dict):
                raise ValueError(f"{name} must map factors to values; got {given[name]!r}")
            parse.known(given[name], tuple(FACTORS), prefix)
        axes = {
            name: tuple(parse.values(value, f"axis.{name}", FACTORS[name].read))
            for name, value in given["axes"].items()
        }
        put("axes", axes)
        put("fixed", _all_factors(axes, given["fixed"]))
        _check_sigma_axes(axes, self.fixed)
        put("zip", parse.groups(given["zip"], "zip", axes))
        for name, read in _FIELDS.items():
            put(name, read(given[name], name))
        for group in self.dims.values():  # of axes that move together, one may repeat a value
            together = list(zip(*(axes[name] for name in group), strict=True))
            parse.distinct(together, ", ".join(f"axis.{name}" for name in group))

    @property
    def dims(self) -> dict[str, tuple[str, ...]]:
        """The dataset's dimensions, each with the factors that vary along it.

        A dimension is named for the first of them.
        """
        group_of = {name: group for group in self.zip for name in group}
        groups = [group_of.get(name, (name,)) for name in self.axes]
        return {group[0]: group for group in groups}


def load_config(path: str | Path, changes: Sequence[str] = ()) -> StudyConfig:
    """Read and check the description of a study.

    Args:
        path: a TOML file; the paths in it are relative to its folder.
        changes: values that replace the file's, each `KEY=VALUE` with the key dotted as in the
            file, such as `"axis.theta_i.logspace=[-1, -3, 5]"`; paths in them are relative to the
            current folder.

    Raises:
        ConfigError: the file is missing or not TOML, or it has an unknown key, or a value of a
            wrong type or out of range.
    """
    path = Path(path)
    given = read_toml(path)
    if isinstance(given.get("demonstrations"), str):
        given["demonstrations"] = str(path.parent / given["demonstrations"])
    try:
        for change in changes:
            _change(given, change)
        return StudyConfig(**_fields_of(given))
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def tuned_changes(path: str | Path) -> list[str]:
    """Return the parameters that `jaxreplay tune` saved, as changes for :func:`load_config`.

    σ is converted from the sensor's unit to a share of the sensor's range. The reading of a jump
    for which the parameters were tuned is not adopted: the study's file gives its own.

    Raises:
        ConfigError: the file is missing or not TOML, or does not contain such parameters, or
            those of other sensors than the plane's.
    """
    given = read_toml(Path(path))
    sigma = given.get("sigma")
    if given.keys() != {"theta_i", "theta_tau", "sigma"} or not isinstance(sigma, dict):
        raise ConfigError(
            f"{path}: must contain theta_i, theta_tau and a table sigma, as jaxreplay tune saves "
            "them"
        )
    if sorted(sigma) != sorted(SENSOR_NAMES):
        raise ConfigError(
            f"{path}: its sensors are {', '.join(sigma)}; the simulated robot has "
            f"{', '.join(SENSOR_NAMES)}"
        )
    values = {name: given[name] for name in ("theta_i", "theta_tau")}
    read = parse.number(0, float("inf"))
    for name, full in zip(SENSOR_NAMES, SENSOR_RANGES, strict=True):
        try:
            values[f"sigma_{name}"] = read(sigma[name], f"sigma.{name}") / full
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from None
    return [f"{name}={value!r}" for name, value in values.items()]


def _change(given: dict, change: str) -> None:
    """Replace one value of a description by `KEY=VALUE`."""
    key, equals, text = change.partition("=")
    *path, last = key.strip().split(".")
    if not equals or not last:
        raise ValueError(f"--set {change}: give KEY=VALUE, such as axis.theta_i=[0.1, 0.01]")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()  # a word without its quotes
    # A factor has either a value or an axis, and an axis one kind of spacing.
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


_FIELDS = {  # readers of the fields besides axes, fixed and zip
    "positions": parse.positions,
    "repeats": parse.whole(1, 10_000),
    "seed": parse.whole(0, 2**63 - 1),
    "slots": parse.whole(1, 4096),
    "demonstrations": parse.path,
    "plane": parse.plane,
}


def _fields_of(given: dict) -> dict[str, Any]:
    """Return the fields of the study that a parsed TOML file describes, not checked yet."""
    axis = given.pop("axis", {})
    if not isinstance(axis, dict):
        raise ValueError(f"axis must be a table, [axis]; got {axis!r}")
    parse.known(given, (*FACTORS, "zip", *_FIELDS, "axis"), "")
    if "demonstrations" in given:
        parse.file(given["demonstrations"], "demonstrations")
    plane = given.get("plane", {})
    for name in SETTINGS if isinstance(plane, dict) else ():
        if name in plane:
            raise ValueError(f"plane.{name} is a factor: give it as {name} or axis.{name}")
    fixed = {name: given.pop(name) for name in FACTORS if name in given}
    return given | {"axes": axis, "fixed": fixed}


def _all_factors(axes: dict[str, tuple], given: dict[str, Any]) -> dict[str, Any]:
    """Return the value of every factor that is no axis."""
    fixed = {}
    for name, factor in FACTORS.items():
        value = given.get(name)
        if value is not None and name in axes:
            raise ValueError(f"{name} and axis.{name} are both given; keep one")
        if value is not None:
            fixed[name] = factor.read(value, name)
        elif name not in axes:
            if factor.default is REQUIRED:
                raise ValueError(f"{name} is missing; give one value, or a list as axis.{name}")
            fixed[name] = factor.default
    return fixed


def _check_sigma_axes(axes: Mapping[str, tuple], fixed: Mapping[str, Any]) -> None:
    given = {*axes, *(name for name, value in fixed.items() if value is not None)}
    enabled = {*(name for name in axes if any(axes[name])), *(n for n, v in fixed.items() if v)}
    used = sigma_factors(given, added_sensors(enabled))
    for name in axes:
        if name.startswith("sigma") and name not in used:
            raise ValueError(f"axis.{name} has no effect: each of its sensors has a σ of its own")
