"""An environment for tests: a point on a line, which has to get beyond 1; with pictures.

Registers `Line-v0`, so that `"line_world:Line-v0"` can be made.
"""

import gymnasium
import numpy as np
from study_helpers import write

from jaxreplay.records import Records

LINE = """
environment = "line_world:Line-v0"
demonstrations = "line.npz"
repeats = 2
[axis]
theta_i = [0.1]
"""


class Line(gymnasium.Env):
    """A point that starts at up to ±0.01 and moves by the action; its info has `is_success`.

    Args:
        goal: beyond it a run succeeds; it goes on, as on the plane.
        edge: beyond it a run is terminated.
        fails_at: step in which it raises an error.
        says: whether the info tells of success.
        render_mode: `"rgb_array"` or None.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - as in Gymnasium

    def __init__(self, goal=1.0, edge=np.inf, says=True, fails_at=0, render_mode=None):
        self.fails_at = fails_at
        self.goal, self.edge, self.says, self.render_mode = goal, edge, says, render_mode
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float64)
        self.x, self.t = 0.0, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = self.np_random.uniform(-0.01, 0.01), 0
        return self.seen(), {}

    def seen(self):
        return np.array([self.x, 7.0])

    def step(self, action):
        self.x, self.t = self.x + action[0], self.t + 1
        _ = 1 / (self.t - self.fails_at)
        info = {"is_success": self.x > self.goal} if self.says else {}
        return self.seen(), float(action[0]), bool(self.x > self.edge), False, info

    def render(self):
        picture = np.full((60, 100, 3), 255, np.uint8)
        picture[25:35, int(np.clip(80 * self.x, 0, 99))] = 0
        return picture


def of_line(folder):
    """The file of a study on a line, with two demonstrations that end at rest beyond its goal."""
    steps = np.hstack([np.full(12, 0.1), np.zeros(20)])[:, None]
    x = np.cumsum(steps, axis=0)
    sensors = [np.hstack([at, np.full_like(at, 7.0)]) for at in (x, x + 0.005)]
    records = Records.from_sequences(sensors, [steps, steps], ["x", "seven"], ["dx"])
    records.save(folder / "line.npz")
    return write(folder, LINE, "line.toml")


gymnasium.register("Line-v0", lambda **how: Line(**how), max_episode_steps=60)
gymnasium.register("Endless-v0", lambda **how: Line(**how))
