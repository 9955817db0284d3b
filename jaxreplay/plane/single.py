"""The plane as a Gymnasium environment of one world."""

from typing import Any

import gymnasium
import numpy as np

from jaxreplay.plane.env import METADATA, PlaneVectorEnv
from jaxreplay.plane.params import PlaneParams


class PlaneEnv(gymnasium.Env):
    """One robot with a cube to fetch: a :class:`PlaneVectorEnv` of one world, without axis B.

    Before the first grasp its info has no `alignment_error`, instead of NaN.
    """

    metadata = METADATA

    def __init__(self, params: PlaneParams | None = None, render_mode: str | None = None):
        """Create the environment; call `reset` before `step`."""
        self._worlds = PlaneVectorEnv(1, params, render_mode)
        self.render_mode = render_mode
        self.observation_space = self._worlds.single_observation_space
        self.action_space = self._worlds.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Restart the world and return its observation `[7]` and info.

        Args:
            seed: of all randomness in the world; drawn if it is None.
            options: those of :meth:`PlaneVectorEnv.reset`, without the axis B; `cube` is `[3]`.

        Raises:
            ValueError: an option is unknown, has the wrong shape or is out of range.
        """
        super().reset(seed=seed)
        seed = int(self.np_random.integers(2**63)) if seed is None else seed
        batched = {name: np.asarray(value)[None] for name, value in (options or {}).items()}
        observation, info = self._worlds.reset(seed=[seed], options=batched)
        return observation[0], _single(info)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out one control step with an action `[5]`.

        Returns:
            The observation `[7]`, reward, terminated, truncated and info.

        Raises:
            ValueError: the action is not 5 finite numbers.
        """
        observation, reward, terminated, truncated, info = self._worlds.step(
            np.asarray(action)[None]
        )
        return (
            observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]),
            _single(info),
        )  # fmt: skip

    def render(self) -> np.ndarray | None:
        """Return a picture from above, `[H, W, 3]` uint8; None without a render mode."""
        return None if self.render_mode is None else self._worlds.render()[0]


def _single(info: dict[str, Any]) -> dict[str, Any]:
    """Return the info of the only world, without the entries that have no value."""
    return {
        name: value[0].item()
        for name, value in info.items()
        if not name.startswith("_") and info[f"_{name}"][0]
    }
