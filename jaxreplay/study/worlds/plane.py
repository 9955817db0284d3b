"""The simulated plane as the world of a study: its factors, its outcomes and its scene."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
from gymnasium.vector import VectorEnv

from jaxreplay.errors import ConfigError
from jaxreplay.loop.replay import Replays
from jaxreplay.plane import light
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, SENSOR_RANGES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED, facing
from jaxreplay.records import Records
from jaxreplay.study.dataset import PlaneScene
from jaxreplay.study.factors import FACTORS, AddedSensor, Factor, sigma_of
from jaxreplay.study.parse import number, one_of
from jaxreplay.study.worlds.world import listed

_PLANE = PlaneParams()

PLANE_FACTORS: dict[str, Factor] = {
    **FACTORS,
    **{f"sigma_{name}": sigma_of(name) for name in ("camera", "proximeters", *SENSOR_NAMES[1:])},
    "light": Factor(
        None,
        one_of(False, True),
        "light",
        "",
        "one more sensor, of the room's light",
        sensor=AddedSensor(light.NAME, light.RANGE, light.light_level, light.Lit),
        batch_key=lambda value, repeat: bool(value),
    ),
    "dithering": Factor(
        _PLANE.dithering, one_of(False, True), "dithering", "", "temporal dithering of the tracks"
    ),
    "motor_unit": Factor(
        _PLANE.motor_unit,
        number(*SETTINGS["motor_unit"]),
        "motor unit",
        "m/s",
        "resolution of the track speeds",
    ),
    "battery": Factor(
        _PLANE.battery,
        number(*SETTINGS["battery"]),
        "battery",
        "1",
        "voltage, as a share of a full battery's",
    ),
    "sensor_noise": Factor(
        _PLANE.sensor_noise,
        number(*SETTINGS["sensor_noise"]),
        "sensor noise",
        "1",
        "factor on the sensors' noise",
    ),
    "track_bias": Factor(
        _PLANE.track_bias,
        number(*SETTINGS["track_bias"]),
        "track bias",
        "1",
        "largest difference of a track's gain from 1, drawn for each run",
    ),
    "placing": Factor(
        _PLANE.placing,
        number(*SETTINGS["placing"]),
        "placing",
        "m",
        "largest error of where the robot is put down, in x and in y",
    ),
    "heading": Factor(
        _PLANE.heading,
        number(*SETTINGS["heading"]),
        "heading",
        "rad",
        "largest error of the robot's heading when it is put down",
    ),
    "cube_turn": Factor(
        _PLANE.cube_turn,
        number(*SETTINGS["cube_turn"]),
        "cube turn",
        "rad",
        "largest angle by which the cube is turned",
    ),
    "push": Factor(
        _PLANE.push,
        number(*SETTINGS["push"]),
        "push",
        "m",
        "largest distance by which each track is pushed once on the way",
    ),
    "taught": Factor(
        "alike",
        one_of("alike", "nominal"),
        "taught",
        "",
        "robot of the demonstrations: the same as replays, or the nominal one",
    ),
}
OUTCOMES = {  # as in figure 3
    "S": "success",
    "Fs": "time limit reached",
    "Fg": "no grasp",
    "Fb": "left the area",
}
STALLS = ("fixed", "cyclic", "slow")  # kinds of an Fs
VARIABLES: dict[str, dict[str, str]] = {
    "stall": {"long_name": "kind of an Fs", "values": " ".join(STALLS)},
    "lifted": {"units": "1", "long_name": "the cube was lifted at any time"},
    "alignment_error": {
        "units": "mm",
        "long_name": "alignment error",
        "column": "error",
        "of": "S",
    },
    "duration": {"units": "s", "long_name": "run duration", "column": "duration", "of": "S"},
}


@dataclass(frozen=True)
class Plane:
    """The plane, as :class:`jaxreplay.study.worlds.world.World`.

    Attributes:
        params: the constants.
        positions: `[P, 2]` of the cube in the test runs, m.
        taught: whether demonstrations are made by the teacher.
    """

    params: PlaneParams
    positions: np.ndarray
    taught: bool

    factors = PLANE_FACTORS
    sensor_names = SENSOR_NAMES
    groups = dict.fromkeys(SENSOR_NAMES[1:], "proximeters")
    outcomes = OUTCOMES
    variables = VARIABLES
    speed = "simulated s/s"

    @property
    def step(self) -> float:
        """Duration of a control step, s."""
        return self.params.control_period

    def time_limit(self) -> float:
        """Return the longest possible duration of a run, s."""
        return self.params.time_limit

    def check(self, records: Records, where: str) -> None:
        """Check that records have the plane's sensors, commands and control period.

        Raises:
            ConfigError: they have not.
        """
        for names, wanted, what in (
            (records.sensor_names, SENSOR_NAMES, "sensors"),
            (records.command_names, COMMAND_NAMES, "commands"),
        ):
            if names != wanted:
                raise ConfigError(
                    f"{where}: its {what} are {listed(names)}; the simulated robot has "
                    f"{', '.join(wanted)}, and can replay no others (for another robot, give its "
                    "environment)"
                )
        if records.period not in (None, self.step):
            raise ConfigError(
                f"{where}: its rows are {records.period} s apart; the plane's control period is "
                f"{self.step} s: resample them"
            )

    def ranges(self, records: Records | None) -> dict[str, float]:
        """Return the range of each sensor of the plane, whatever the records contain of it."""
        return dict(zip(SENSOR_NAMES, SENSOR_RANGES, strict=True))

    def make(self, slots: int, render: bool = False) -> VectorEnv:
        """Return B slots for worlds; they can always be looked at."""
        return PlaneVectorEnv(slots, self.params)

    def failures(self) -> AbstractContextManager[None]:
        """Return a context that changes nothing: all code is this package's."""
        return nullcontext()

    def options(self, values: dict[str, np.ndarray], position: np.ndarray) -> dict[str, np.ndarray]:
        """Return the settings of n runs, and where their cubes are (`cube`, `[n, 3]`)."""
        return {name: values[name] for name in SETTINGS} | {
            "cube": facing(self.positions[position])
        }

    @staticmethod
    def outcome(replays: Replays) -> np.ndarray:
        """Return how replays ended, `[n]`, as in figure 3; empty while they run.

        S: the cube is held and lifted when the replay ends. Fs: not ended within the time limit.
        Fg: ended without the cube. Fb: left the experimental area.
        """
        success = replays.info.get("is_success", np.zeros(len(replays.ending), bool))
        completed = np.where(success, "S", "Fg")
        ways = [replays.ending == way for way in ("terminated", "completed", "truncated")]
        return np.select(ways, ["Fb", completed, "Fs"], "")

    def results(self, replays: Replays) -> dict[str, np.ndarray]:
        """Return stall, lifting, alignment error (of S) and duration of n replays, `[n]` each."""
        info, success = replays.info, self.outcome(replays) == "S"
        return {
            "stall": info["stall"],
            "lifted": info["was_lifted"],
            "alignment_error": np.where(success, 1e3 * info["alignment_error"], np.nan),
            "duration": replays.steps * self.step,
        }

    def ending(self, replays: Replays) -> str:
        """Return how the first replay ended, such as `"S, error 2.3 mm"` or `"Fs (fixed)"`."""
        outcome, stall = self.outcome(replays)[0], replays.info["stall"][0]
        if outcome == "S":
            return f"S, error {1e3 * replays.info['alignment_error'][0]:.1f} mm"
        return f"{outcome} ({stall})" if stall else str(outcome)

    def look(self, worlds: VectorEnv) -> "_Seen":
        """Return the pose of the first robot, cube and gripper."""
        plane = cast(PlaneVectorEnv, worlds.unwrapped)
        robot, cube, elevation, tilt = (x[0].copy() for x in plane.pose)
        return _Seen(robot, cube, elevation, tilt, bool(plane.held[0]))

    def scene(self, seen: Sequence["_Seen"]) -> PlaneScene:
        """Return the poses of a run, step by step."""
        robot, cube, elevation, tilt, held = map(np.array, zip(*seen, strict=True))
        return PlaneScene(robot, cube, elevation, tilt, held, self.params)

    def coordinates(self) -> dict[str, Any]:
        """Return where the cubes are, and were in the teacher's demonstrations."""
        ahead, aside = (
            {"units": "m", "long_name": f"cube, {way}"} for way in ("ahead", "to the left")
        )
        coordinates: dict[str, Any] = {
            "position": np.arange(len(self.positions)),
            "cube_x": ("position", self.positions[:, 0], ahead),
            "cube_y": ("position", self.positions[:, 1], aside),
        }
        if self.taught:  # a file of records does not contain the cubes' positions
            coordinates["demonstrated_x"] = ("demonstration", DEMONSTRATED[:, 0], ahead)
            coordinates["demonstrated_y"] = ("demonstration", DEMONSTRATED[:, 1], aside)
        return coordinates


class _Seen(NamedTuple):
    """Where everything is at one step; see :class:`jaxreplay.study.dataset.PlaneScene`."""

    robot: np.ndarray
    cube: np.ndarray
    elevation: np.ndarray
    tilt: np.ndarray
    held: bool
