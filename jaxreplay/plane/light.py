"""A sensor that has nothing to do with the action, as § 4 warns of: the light in the room.

It differs between demonstrations and between runs, and is constant during each of them.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorWrapper

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import seeds_of

NAME = "light"
RANGE = 1.0  # highest minus lowest value


def light_level(*seed: int) -> float:
    """Return the light of a world or demonstration with this seed, uniform in [0, 1]."""
    return float(np.random.default_rng([*seed, 3]).uniform())


class Lit(VectorWrapper):
    """The plane's worlds with one more sensor, the light: observations are `[B, 8]`."""

    def __init__(self, env: PlaneVectorEnv):
        """Wrap worlds; each gets its light, in [0, 1], when it is reset with a seed."""
        super().__init__(env)
        self._plane = env
        self._light = np.zeros((env.num_envs, 1), np.float32)
        seen = env.single_observation_space
        assert isinstance(seen, gymnasium.spaces.Box)
        self.single_observation_space = gymnasium.spaces.Box(
            np.append(seen.low, np.float32(0)), np.append(seen.high, np.float32(1))
        )
        self.observation_space = gymnasium.vector.utils.batch_space(
            self.single_observation_space, env.num_envs
        )

    @property
    def resting(self) -> np.ndarray:
        """`[B]` bool, the worlds that rest; see :class:`PlaneVectorEnv`."""
        return self._plane.resting

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Restart worlds as :meth:`PlaneVectorEnv.reset` does.

        The light of a restarted world follows from its seed; without a seed it stays as it was.

        Raises:
            ValueError: as :meth:`PlaneVectorEnv.reset`.
        """
        observed, info = self._plane.reset(seed=seed, options=options)
        n = self._plane.num_envs
        seeds = seeds_of(seed, n)
        for b in np.flatnonzero((options or {}).get("reset_mask", np.ones(n, bool))):
            if (own := seeds[b]) is not None:
                self._light[b] = light_level(own)
        return np.hstack([observed, self._light]), info

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Carry out one control step as :meth:`PlaneVectorEnv.step` does."""
        observed, reward, terminated, truncated, info = self._plane.step(actions)
        return np.hstack([observed, self._light]), reward, terminated, truncated, info
