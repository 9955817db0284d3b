"""Any Gymnasium environment as the world of a study; its demonstrations are a user's own."""

import traceback
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from PIL import Image

from jaxreplay.errors import ConfigError
from jaxreplay.loop.checks import check_environment
from jaxreplay.loop.replay import LOST, Replays
from jaxreplay.recordings.scores import sensor_span
from jaxreplay.records import Records
from jaxreplay.records.columns import command_range
from jaxreplay.study.dataset import Pictures
from jaxreplay.study.factors import FACTORS, Factor, sigma_of

OUTCOMES = {  # each F is without success
    "S": "success",
    "Fs": "time limit reached",
    "Fe": "records' end reached",
    "Ft": "terminated",
}
VARIABLES: dict[str, dict[str, str]] = {
    "return": {"units": "1", "long_name": "return", "column": "return"},
    "duration": {
        "units": "steps",
        "long_name": "run duration",
        "column": "duration",
        "of": "S",
    },
    "distance": {
        "units": "σ",
        "long_name": "median distance to the sample followed",
        "column": "distance",
        "lost": f"{LOST:g}",
    },
}
_SUCCESS = ("is_success", "success")  # the usual names in an environment's info
_WIDTH = 480  # largest width of a picture that is kept, pixels


@dataclass(frozen=True)
class Environment:
    """An environment, as :class:`jaxreplay.study.worlds.world.World`.

    A run succeeds if the environment's info says so (`is_success`) at the run's last step, or, with
    `success_return`, if the sum of its rewards is at least that.

    Attributes:
        id: of Gymnasium, `"NAME"` or `"module:NAME"`.
        arguments: of the environment, such as `max_episode_steps`.
        success_return: the least return of a success; None: the environment's info decides.
        sigmas: names of the sensors whose σ the study gives.
    """

    id: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    success_return: float | None = None
    sigmas: tuple[str, ...] = ()

    sensor_names = None
    groups = {}  # noqa: RUF012
    outcomes = OUTCOMES
    variables = VARIABLES
    step = 1.0
    speed = "steps/s"

    @property
    def factors(self) -> dict[str, Factor]:
        """Those of every study, and σ of some sensors."""
        return FACTORS | {f"sigma_{name}": sigma_of(name) for name in self.sigmas}

    def time_limit(self) -> float:
        """Return the largest number of steps of a run.

        Raises:
            ConfigError: the environment has no time limit.
        """
        with closing(self.make(1)) as worlds:
            return _limit(worlds, self.id)

    def check(self, records: Records, where: str) -> None:
        """Check that the environment can be made and stepped with commands of these records.

        Raises:
            ConfigError: it cannot be made, does not fit the records, or has no time limit; or σ is
                given of sensors that the records do not have.
        """
        for name in self.sigmas:
            if name not in records.sensor_names:
                known = ", ".join(f"sigma_{sensor}" for sensor in records.sensor_names)
                raise ConfigError(f"sigma_{name}: by the sensors in {where} there are {known}")
        with closing(self.make(1)) as worlds:
            try:
                check_environment(records, worlds)
            except ValueError as error:
                raise ConfigError(f"environment {self.id} and {where}: {error}") from None
            _limit(worlds, self.id)
            seen = np.asarray(records.span, float) + np.asarray(records.offset)
            sent = command_range(records.commands, records.lengths)
            observations, actions = worlds.single_observation_space, worlds.single_action_space
            _warn_beyond("sensor", records.sensor_names, seen, cast(Box, observations), where)
            _warn_beyond("command", records.command_names, sent, cast(Box, actions), where)

    def ranges(self, records: Records | None) -> dict[str, float]:
        """Return the range of each sensor in the records; 1 if it never changes."""
        assert records is not None
        return dict(zip(records.sensor_names, sensor_span(records).tolist(), strict=True))

    def make(self, slots: int, render: bool = False) -> VectorEnv:
        """Return B environments that advance together.

        With `render` they give pictures, if the environment can.

        Raises:
            ConfigError: there is no such environment, or it cannot be made.
        """
        pictures = {"render_mode": "rgb_array"} if render and self._has_pictures() else {}
        try:
            return self._made(slots, **pictures)
        except Exception as error:  # a user's environment may raise anything
            cause = f"{type(error).__name__}: {' '.join(f'{error}'.split())}"
            if isinstance(error, gymnasium.error.NameNotFound) and ":" not in self.id:
                cause += f' One of your own is "module:{self.id}".'
            if isinstance(error, ModuleNotFoundError):
                cause += " Modules are found where they are installed, and in the current folder."
            raise ConfigError(f"environment {self.id} cannot be made: {cause}") from None

    def _made(self, slots: int, **arguments: Any) -> VectorEnv:
        return gymnasium.make_vec(
            self.id,
            slots,
            vectorization_mode="sync",
            vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED},
            **{**self.arguments, **arguments},
        )

    def _has_pictures(self) -> bool:
        """Return whether the environment gives pictures; warn if it should, and cannot."""
        with closing(self.make(1)) as worlds:
            if "rgb_array" not in (worlds.metadata.get("render_modes") or ()):
                return False
        try:
            with closing(self._made(1, render_mode="rgb_array")) as worlds:
                worlds.reset(seed=0)
                return _picture(worlds) is not None
        except Exception as error:  # a library is not installed, there is no display, …
            cause = " ".join(f"{error}".split())
            warnings.warn(f"environment {self.id} gives no pictures: {cause}", stacklevel=2)
            return False

    @contextmanager
    def failures(self) -> Iterator[None]:
        """Tell in one line of an error that the environment raises, and where.

        Raises:
            ConfigError: it raised one.
        """
        try:
            yield
        except (ConfigError, OSError):
            raise
        except Exception as error:  # a user's environment may raise anything
            *_, last = traceback.extract_tb(error.__traceback__)
            raise ConfigError(
                f"environment {self.id} failed: {type(error).__name__}: "
                f"{' '.join(f'{error}'.split())} ({last.filename}, line {last.lineno})"
            ) from error

    def options(self, values: dict[str, np.ndarray], position: np.ndarray) -> dict[str, np.ndarray]:
        """Return no options: a run depends on its seed alone."""
        return {}

    def outcome(self, replays: Replays) -> np.ndarray:
        """Return how replays ended, `[n]`: one of `OUTCOMES`; empty while they run.

        Raises:
            ConfigError: a replay has ended, and it cannot be known whether it succeeded.
        """
        if self.success_return is not None:
            success = replays.reward >= self.success_return
        else:
            given = [replays.info[name] for name in _SUCCESS if name in replays.info]
            if not given and (replays.ending != "").any():
                raise ConfigError(
                    f"environment {self.id} does not say whether a run succeeded (its info has no "
                    "is_success): give success_return, the least return of a success"
                )
            success = np.nan_to_num(given[0].astype(float)) > 0.5 if given else False
        ended = replays.ending != ""
        ways = [replays.ending == way for way in ("terminated", "completed", "truncated")]
        return np.select([ended & success, *ways], ["S", "Ft", "Fe", "Fs"], "")

    def results(self, replays: Replays) -> dict[str, np.ndarray]:
        """Return return, number of steps, and median distance in σ, `[n]` each."""
        return {
            "return": replays.reward,
            "duration": replays.steps * self.step,
            "distance": replays.distance_median,
        }

    def ending(self, replays: Replays) -> str:
        """Return how the first replay ended, such as `"S, return 93.4"`."""
        return f"{self.outcome(replays)[0]}, return {replays.reward[0]:.4g}"

    def look(self, worlds: VectorEnv) -> bytes | None:
        """Return a picture of the first environment, as a PNG file's bytes, if it gives one."""
        picture = _picture(worlds)
        if picture is None:
            return None
        picture.thumbnail((_WIDTH, _WIDTH))
        file = BytesIO()
        picture.save(file, "PNG")
        return file.getvalue()

    def scene(self, seen: Sequence[bytes | None]) -> Pictures | None:
        """Return the pictures of a run, if there are any."""
        files = [file for file in seen if file is not None]
        return Pictures(files) if len(files) == len(seen) else None

    def coordinates(self) -> dict[str, Any]:
        """Return none: an environment has no positions."""
        return {}


def _limit(worlds: VectorEnv, id: str) -> int:
    """Return the largest number of steps of a run.

    Raises:
        ConfigError: there is none.
    """
    spec = worlds.envs[0].spec if isinstance(worlds, SyncVectorEnv) else worlds.spec
    if spec is None or spec.max_episode_steps is None:
        raise ConfigError(
            f"environment {id} has no time limit: give it one among its arguments, such as "
            f'environment = {{id = "{id}", max_episode_steps = 1000}}'
        )
    return spec.max_episode_steps


def _picture(worlds: VectorEnv) -> Image.Image | None:
    """Return a picture of the first environment, if it gives one."""
    frames = worlds.render() if worlds.render_mode else None
    return Image.fromarray(frames[0]) if frames and isinstance(frames[0], np.ndarray) else None


def _warn_beyond(
    what: str, names: tuple[str, ...], reach: np.ndarray, space: Box, where: str
) -> None:
    """Warn of columns that go beyond the environment's space: another unit, or another order.

    Args:
        what: sensor or command.
        names: `[n]` of the columns.
        reach: `[2, n]` their lowest and highest values.
        space: of the environment's observations or actions.
        where: the file.
    """
    (lowest, highest), low, high = reach, space.low, space.high
    slack = 1e-3 * np.maximum(highest - lowest, 1e-9)
    for k in np.flatnonzero((lowest < low - slack) | (highest > high + slack)):
        warnings.warn(
            f"{where}: {what} {names[k]} goes from {lowest[k]:.4g} to {highest[k]:.4g}, but number "
            f"{k} of the environment's {'observations' if what == 'sensor' else 'actions'} from "
            f"{low[k]:.4g} to {high[k]:.4g}: check units and order",
            stacklevel=2,
        )
