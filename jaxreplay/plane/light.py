"""A sensor that has nothing to do with the action, as § 4 warns of: the light in the room.

It differs from run to run, in demonstrations as in replays, and stays as it is during one.
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorWrapper

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.records import Records

NAME = "light"


def _level(*seed: int) -> float:
    return float(np.random.default_rng([*seed, 3]).uniform())


class Lit(VectorWrapper):
    """Worlds with one more sensor: the light, anywhere from 0 to 1 by a world's seed."""

    def __init__(self, env: PlaneVectorEnv):
        """Around worlds that are told a seed each when they are reset."""
        super().__init__(env)
        self._light = np.zeros((env.num_envs, 1), np.float32)
        seen = env.single_observation_space
        self.single_observation_space = gymnasium.spaces.Box(
            np.append(seen.low, np.float32(0)), np.append(seen.high, np.float32(1))
        )
        self.observation_space = gymnasium.vector.utils.batch_space(
            self.single_observation_space, env.num_envs
        )

    @property
    def resting(self) -> np.ndarray:
        """`[B]` which worlds rest."""
        return self.env.resting

    def reset(self, *, seed: list[int | None], options: dict[str, Any]):
        """As the worlds do; those with a seed get light."""
        for b in np.flatnonzero(options["reset_mask"]):
            if seed[b] is not None:
                self._light[b] = _level(seed[b])
        observed, info = self.env.reset(seed=seed, options=options)
        return np.hstack([observed, self._light]), info

    def step(self, actions: np.ndarray):
        """As the worlds do."""
        observed, *others = self.env.step(actions)
        return np.hstack([observed, self._light]), *others


def lit(records: Records, seed: int) -> Records:
    """Records of the plane, each in a light of its own."""
    sensors, commands = records.sequences()
    light = [np.full((len(rows), 1), _level(seed, i)) for i, rows in enumerate(sensors)]
    return Records.from_sequences(
        [np.hstack(pair) for pair in zip(sensors, light, strict=True)],
        commands,
        (*records.sensor_names, NAME),
        records.command_names,
        records.period,
    )
