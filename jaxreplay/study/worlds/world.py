"""What a study needs to know of the world in which its runs happen."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np
from gymnasium.vector import VectorEnv

from jaxreplay.loop.replay import Replays
from jaxreplay.records import Records
from jaxreplay.study.dataset import Pictures, PlaneScene
from jaxreplay.study.factors import Factor


class World(Protocol):
    """A world of B slots for runs, its factors, and how its results are stored."""

    @property
    def factors(self) -> Mapping[str, Factor]:
        """What a study can vary, by name."""
        ...

    @property
    def sensor_names(self) -> tuple[str, ...] | None:
        """Names of the sensors; None: they are those of the records."""
        ...

    @property
    def groups(self) -> Mapping[str, str]:
        """The group of each sensor that shares a σ factor with others."""
        ...

    @property
    def outcomes(self) -> Mapping[str, str]:
        """How a run can end: a code of at most two letters, and what it means; S first."""
        ...

    @property
    def variables(self) -> Mapping[str, Mapping[str, str]]:
        """What is stored of a run beside what the filter gives: name and attributes.

        The attributes `column` (its head in a table) and `of` (S: of successful runs) mark those
        that tables and figures show; `values` lists the values of a word.
        """
        ...

    @property
    def step(self) -> float:
        """Duration of a control step, in the unit of the variable `duration`."""
        ...

    @property
    def speed(self) -> str:
        """What is simulated per second, in words."""
        ...

    def time_limit(self) -> float:
        """Return the longest possible duration of a run."""
        ...

    def check(self, records: Records, where: str) -> None:
        """Check that records, read from a file, can be replayed in this world.

        Raises:
            ConfigError: they cannot.
        """
        ...

    def ranges(self, records: Records | None) -> dict[str, float]:
        """Return the range of each sensor, by which its σ is multiplied.

        It can be that of the records; where the world has a range of its own, they may be None.
        """
        ...

    def make(self, slots: int, render: bool = False) -> VectorEnv:
        """Return B slots; with `render`, such as can be looked at.

        Raises:
            ConfigError: they cannot be made.
        """
        ...

    def failures(self) -> AbstractContextManager[None]:
        """Return a context in which an error of a user's own environment is told in one line."""
        ...

    def options(self, values: dict[str, np.ndarray], position: np.ndarray) -> dict[str, np.ndarray]:
        """Return the options with which n runs are reset.

        Args:
            values: of the factors, `[n]` by name.
            position: `[n]` index of each run's position.
        """
        ...

    def outcome(self, replays: Replays) -> np.ndarray:
        """Return the code of how each of n replays ended, `[n]`; empty while it runs."""
        ...

    def results(self, replays: Replays) -> dict[str, np.ndarray]:
        """Return the world's own variables of n replays, `[n]` by name."""
        ...

    def ending(self, replays: Replays) -> str:
        """Return in words how the first replay ended."""
        ...

    def look(self, worlds: VectorEnv) -> Any:
        """Return what is to be seen in the first slot, for :meth:`scene`."""
        ...

    def scene(self, seen: Sequence[Any]) -> PlaneScene | Pictures | None:
        """Return what was seen at each step of a run, in a form that can be drawn."""
        ...

    def coordinates(self) -> dict[str, Any]:
        """Return coordinates of the dataset along `position`, if the world has positions."""
        ...


def listed(names: Sequence[str]) -> str:
    """Return names for a message, some 20 of them at most."""
    return ", ".join(names[:20]) + (", …" if len(names) > 20 else "")
