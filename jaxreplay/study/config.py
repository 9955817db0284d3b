"""The description of a study, read from a TOML file and strictly checked."""

import warnings
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, fields
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from jaxreplay.errors import ConfigError
from jaxreplay.machine import read_toml
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import TESTED
from jaxreplay.study import parse
from jaxreplay.study.changes import apply, put, tuned_values
from jaxreplay.study.factors import FACTORS, REQUIRED, Factor, added_sensors, sigma_factors
from jaxreplay.study.file import File, check_there, read_file, records_in, relative
from jaxreplay.study.worlds.environment import Environment
from jaxreplay.study.worlds.plane import PLANE_FACTORS, Plane
from jaxreplay.study.worlds.world import World

SLOTS = 56  # worlds that advance together by default
MOST_RUNS = 1_000_000  # their factors alone take a GB
RUNS = 15  # of each cell by default: the paper's 5 positions × 3, or 15 of an environment


@dataclass(frozen=True)
class StudyConfig:
    """A study: every combination of its axes' values × test positions × repeats.

    `StudyConfig(axes={"theta_i": [0.1, 0.01]})` is complete: what is not given has the default
    that a TOML file's has, and all values are checked and converted as a file's are. Its runs
    happen on the simulated plane, or in an environment of the user's.

    Attributes:
        axes: the values of each factor that varies, in the file's order.
        fixed: the value of every other factor.
        zip: groups of axes that move together: value k of one goes with value k of the others.
        positions: of the cube in the test runs, (x, y) in m from the robot's start; none in an
            environment.
        repeats: runs at each position, by default 3; of an environment, by default 15.
        seed: of the demonstrations and the runs, a non-negative integer.
        slots: worlds that advance together.
        demonstrations: the records to replay: a file, or the arguments of :func:`jaxreplay.read`
            with `file` as the path; None: the plane's own, made by the teacher.
        environment: a Gymnasium environment to run in, `"NAME"` or `"module:NAME"`; or `id` and its
            arguments, such as `{"id": NAME, "max_episode_steps": 200}`. None: the plane.
        success_return: the least return of a success in an environment; None: its info decides
            (`is_success` at the last step).
        plane: the constants of robot, cube, sensors and area. Those that are factors (such as
            `motor_unit`) are given as factors.

    Raises:
        ConfigError: an unknown name, or a value of a wrong type or out of range.
    """

    axes: Mapping[str, Any] = field(default_factory=dict)
    fixed: Mapping[str, Any] = field(default_factory=dict)
    zip: tuple[tuple[str, ...], ...] = ()
    positions: tuple[tuple[float, float], ...] = tuple(map(tuple, TESTED.tolist()))
    repeats: int = None  # pyright: ignore[reportAssignmentType] - see above
    seed: int = 0
    slots: int = SLOTS
    demonstrations: File | None = None
    environment: str | Mapping[str, Any] | None = None
    success_return: float | None = None
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

        def keep(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        given = {f.name: parse.plain(getattr(self, f.name)) for f in fields(self)}
        for name, read in _FIELDS.items():
            keep(name, read(given[name], name))
        for name in ("axes", "fixed"):
            if not isinstance(given[name], dict):
                raise ValueError(f"{name} must map factors to values; got {given[name]!r}")
            keep(name, given[name])  # by these names an environment knows its factors
        if self.environment is None:
            _check_plane_study(given)
            keep("positions", parse.positions(given["positions"], "positions"))
        else:
            _check_environment_study(given)
            keep("positions", ())
        if self.repeats is None:
            keep("repeats", RUNS if self.environment is not None else RUNS // len(TESTED))
        factors = self.world.factors
        for name, prefix in (("axes", "axis."), ("fixed", "")):
            parse.known(given[name], tuple(factors), prefix)
        axes = {
            name: tuple(parse.values(value, f"axis.{name}", factors[name].read))
            for name, value in given["axes"].items()
        }
        keep("axes", axes)
        keep("fixed", _all_factors(factors, axes, given["fixed"]))
        keep("zip", parse.groups(given["zip"], "zip", axes))
        if self.world.sensor_names is not None:
            check_sigma(self, self.world.sensor_names)
        for group in self.dims.values():  # of axes that move together, one may repeat a value
            together = list(zip(*(axes[name] for name in group), strict=True))
            parse.distinct(together, ", ".join(f"axis.{name}" for name in group))
        if self.n_runs > MOST_RUNS:
            raise ValueError(
                f"the study has {self.n_runs:.3g} runs; at most {MOST_RUNS:,} are possible"
            )

    def values_of(self, factor: str) -> tuple:
        """Return the values of a factor: those of its axis, or the one that is fixed."""
        return self.axes[factor] if factor in self.axes else (self.fixed[factor],)

    @property
    def n_runs(self) -> int:
        """How many runs it has."""
        cells = prod(len(self.axes[name]) for name in self.dims)
        return cells * max(len(self.positions), 1) * self.repeats

    @property
    def world(self) -> World:
        """The world in which the runs happen."""
        if self.environment is None:
            positions = np.array(self.positions)
            return Plane(self.plane, positions, taught=self.demonstrations is None)
        given = {"id": self.environment} if isinstance(self.environment, str) else self.environment
        arguments = {name: value for name, value in given.items() if name != "id"}
        named = (name for name in (*self.axes, *self.fixed) if str(name).startswith("sigma_"))
        sigmas = tuple(name.removeprefix("sigma_") for name in named)
        return Environment(given["id"], arguments, self.success_return, sigmas)

    @property
    def dims(self) -> dict[str, tuple[str, ...]]:
        """The dataset's dimensions, each with the factors that vary along it.

        A dimension is named for the first of them.
        """
        group_of = {name: group for group in self.zip for name in group}
        groups = [group_of.get(name, (name,)) for name in self.axes]
        return {group[0]: group for group in groups}


def load_config(
    path: str | Path, changes: Sequence[str] = (), params: str | Path | None = None
) -> StudyConfig:
    """Read and check the description of a study.

    Args:
        path: a TOML file; the paths in it are relative to its folder.
        changes: values that replace the file's, each `KEY=VALUE` with the key dotted as in the
            file, such as `"axis.theta_i.logspace=[-1, -3, 5]"`; paths in them are relative to the
            current folder.
        params: a file of θ_I, θ_τ and σ saved by `jaxreplay tune`, which replace those in `path`;
            `changes` replace them in turn. The reading of a jump for which they were tuned is not
            adopted: the study has its own.

    Raises:
        ConfigError: a file is missing or not TOML, or it has an unknown key, or a value of a
            wrong type or out of range.
    """
    path = Path(path)
    given = read_toml(path)
    if "demonstrations" in given:
        given["demonstrations"] = relative(given["demonstrations"], path.parent)
    tuned = tuned_values(Path(params), _ranges(path, given, changes)) if params is not None else {}
    if replaced := [f"axis.{name}" for name in tuned if name in given.get("axis", {})]:
        warnings.warn(f"{params} takes the place of {', '.join(replaced)}", stacklevel=2)
    for name, value in tuned.items():
        put(value, given, [name])
    without_effect = {"sigma", *(f"sigma_{group}" for group in Plane.groups.values())}
    for change in changes if tuned else ():
        if change.partition("=")[0].strip() in without_effect:
            raise ConfigError(
                f"--set {change} has no effect beside {params}, which gives each sensor its own σ: "
                "set those, such as sigma_NAME"
            )
    return _changed(path, given, changes)


def _changed(path: Path, given: dict, changes: Sequence[str]) -> StudyConfig:
    """Return the study that a parsed TOML file, with changes, describes."""
    try:
        for change in changes:
            apply(change, given)
        return StudyConfig(**_fields_of(given))
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def _ranges(path: Path, study: dict, changes: Sequence[str]) -> dict[str, float]:
    """Return the range of each sensor of a study whose θ_I need not be given yet."""
    study = deepcopy(study)
    if "theta_i" not in study.get("axis", {}):
        study.setdefault("theta_i", 0.1)
    config = _changed(path, study, changes)
    if config.world.sensor_names is None:
        assert config.demonstrations is not None
        return config.world.ranges(records_in(config.demonstrations))
    return config.world.ranges(None)


_FIELDS = {  # readers of the fields besides axes, fixed, zip and positions
    "repeats": parse.optional(parse.whole(1, 10_000)),
    "seed": parse.whole(0, 2**63 - 1),
    "slots": parse.whole(1, 4096),
    "demonstrations": read_file,
    "environment": parse.environment,
    "success_return": parse.optional(parse.number(-1e300, 1e300)),
    "plane": parse.plane,
}


def _fields_of(given: dict) -> dict[str, Any]:
    """Return the fields of the study that a parsed TOML file describes, not checked yet."""
    axis = given.pop("axis", {})
    if not isinstance(axis, dict):
        raise ValueError(f"axis must be a table, [axis]; got {axis!r}")
    factors = [*PLANE_FACTORS]
    if "environment" in given:
        factors += [name for name in given if name.startswith("sigma_")]
    keys = (*dict.fromkeys(factors), "zip", "positions", *_FIELDS, "axis")
    parse.known(given, keys, "")
    for table in ("environment", "demonstrations"):  # what follows [table] in TOML is in it
        inside = given.get(table)
        for name in inside if isinstance(inside, dict) else ():
            if name in keys:
                raise ValueError(f"{table}.{name}: {name} is of the study: put it above [{table}]")
    check_there(given.get("demonstrations"), "demonstrations")
    plane = given.get("plane", {})
    for name in SETTINGS if isinstance(plane, dict) else ():
        if name in plane:
            raise ValueError(f"plane.{name} is a factor: give it as {name} or axis.{name}")
    fixed = {name: given.pop(name) for name in tuple(given) if name in factors}
    return given | {"axes": axis, "fixed": fixed}


def _all_factors(
    factors: Mapping[str, Factor], axes: dict[str, tuple], given: dict[str, Any]
) -> dict[str, Any]:
    """Return the value of every factor that is no axis."""
    fixed = {}
    for name, factor in factors.items():
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


def check_sigma(config: StudyConfig, sensors: Sequence[str]) -> None:
    """Check that each axis of σ has an effect in a study with these sensors.

    Raises:
        ValueError: an axis has none.
    """
    factors, axes = config.world.factors, config.axes
    given = {*axes, *(name for name, value in config.fixed.items() if value is not None)}
    enabled = {n for n in axes if any(axes[n])} | {n for n, v in config.fixed.items() if v}
    added = [sensor.name for sensor in added_sensors(factors, enabled)]
    used = sigma_factors(given, (*sensors, *added), config.world.groups)
    for name in axes:
        if name.startswith("sigma") and name not in used:
            raise ValueError(f"axis.{name} has no effect: each of its sensors has a σ of its own")


def _check_plane_study(given: dict[str, Any]) -> None:
    if given["success_return"] is not None:
        raise ValueError("success_return is of an environment: give it as environment, too")


def _check_environment_study(given: dict[str, Any]) -> None:
    """Check that a study in an environment asks for nothing that only the plane has."""
    if given["demonstrations"] is None:
        raise ValueError("demonstrations is missing: a study in an environment needs a file")
    if given["plane"] != parse.plain(PlaneParams()):
        raise ValueError("plane sets the simulated robot; a study in an environment has none")
    if given["positions"] not in ([], parse.plain(TESTED)):
        raise ValueError("positions are the cube's; a study in an environment has none")
    for name in (*given["axes"], *given["fixed"]):
        if name in PLANE_FACTORS and name not in FACTORS and not name.startswith("sigma_"):
            raise ValueError(f"{name} is of the simulated robot; this study has an environment")
