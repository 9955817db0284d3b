"""An animation of one replay: the plane, the belief as it travels, sensors and commands."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from PIL import Image

from jaxreplay.config import StudyConfig
from jaxreplay.factors import FACTORS
from jaxreplay.filter import build_filter
from jaxreplay.params import Params
from jaxreplay.plane.drawing import Scene
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.sensors import Pose
from jaxreplay.records import Records
from jaxreplay.replay import Replays, replay
from jaxreplay.runs import Runs, records_of, runs_of, setting, worlds_for
from jaxreplay.study import outcomes
from jaxreplay.table import short

FRAMES = 10  # per second of the animation
HOLD = 2  # s that the last frame stays
_BIN = 4  # moments shown as one


class Watched(NamedTuple):
    """All that one replay of T steps did.

    Attributes:
        replays: what came of it, n = 1.
        poses: T of them, after each step.
        held: `[T]` whether the cube was held.
        observations: `[T, n_s]`.
        commands: `[T, 5]`.
    """

    replays: Replays
    poses: list[Pose]
    held: np.ndarray
    observations: np.ndarray
    commands: np.ndarray


class _Recorder(VectorWrapper):
    def __init__(self, env: VectorEnv):
        super().__init__(env)
        self.rows: list[tuple] = []

    def step(self, actions):
        """Carry it out, and keep what was sent, seen and done."""
        result = self.env.step(actions)
        plane = self.env.unwrapped
        pose = Pose(*(x.copy() for x in plane.pose))
        self.rows.append((pose, bool(plane.held[0]), result[0][0].copy(), actions[0].copy()))
        return result


def watched(
    records: Records,
    params: Params,
    worlds: VectorEnv,
    jump: str,
    seed: int,
    options: dict[str, np.ndarray],
) -> Watched:
    """Run one replay and keep all of it; arguments as :func:`jaxreplay.replay.replay`, n = 1."""
    env = _Recorder(worlds)
    replays = replay(records, params, env, jump, [seed], options)
    poses, held, observations, commands = zip(*env.rows, strict=True)
    return Watched(replays, list(poses), *map(np.array, (held, observations, commands)))


def beliefs(records: Records, params: Params, jump: str, observations: np.ndarray) -> np.ndarray:
    """p(I, τ | Z_1:t) of every step of a replay, `[T, N, L]`; all moments are held."""
    filter = build_filter(jump)

    def step(belief, z):
        belief, _ = filter.update(records, params, filter.predict(records, params, belief), z)
        return belief, filter.posterior(records, belief)

    z = jnp.asarray(records.centre(observations))
    return np.asarray(jax.jit(lambda: jax.lax.scan(step, filter.init(records), z)[1])())


def done_again(
    config: StudyConfig, records: Records, k: int
) -> tuple[Runs, Records, Watched, np.ndarray]:
    """Do the k-th run of a study again: which it is, what it replays, all it did, its beliefs."""
    one = runs_of(config).of(np.array([k]))
    params, (seed,), options = setting(config, one)
    records = records_of(config, records, one)
    jump = str(one.values["jump"][0])
    run = watched(records, params, worlds_for(one, 1), jump, seed, options)
    belief = beliefs(records, jax.tree.map(lambda x: x[0], params), jump, run.observations)
    return one, records, run, belief


def animate_run(
    config: StudyConfig,
    records: Records,
    k: int,
    path: Path,
    speed: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> str:
    """Do the k-th run of a study again, and write its animation; see :func:`animate`.

    Returns:
        What run it was, and how it ended.
    """
    one, records, run, belief = done_again(config, records, k)
    title = _title(one, run.replays)
    animate(run, belief, records, title, path, speed, progress)
    return title


def _title(one: Runs, replays: Replays) -> str:
    values = [
        f"{FACTORS[name].symbol} {short(value[0])}"
        for name, value in one.values.items()
        if value[0] is not None
    ]
    where = f"position {one.position[0]}, repeat {one.repeat[0]}"
    outcome, stall = outcomes(replays)[0], replays.info["stall"][0]
    ended = f"{outcome}{f' ({stall})' if stall else ''}"
    if outcome == "S":
        ended += f", error {1e3 * replays.info['alignment_error'][0]:.1f} mm"
    return f"{ended}\n{', '.join(values)}; {where}"


def animate(
    run: Watched,
    belief: np.ndarray,
    records: Records,
    title: str,
    path: Path,
    speed: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Write the animation of a run to a GIF, or a still of its end to a PNG.

    Args:
        run: the replay.
        belief: its beliefs, see :func:`beliefs`.
        records: what was replayed.
        title: stands above it.
        path: of the GIF or PNG.
        speed: times real time.
        progress: called after each frame with the frames done and their total.
    """
    steps = frames(len(run.poses), speed)[-1 if path.suffix == ".png" else 0 :]
    view = View(run, belief, records, title)
    pictures = []
    for t in steps:
        view.show(t)
        pictures.append(view.picture())
        progress(len(pictures), len(steps))
    first, *others = pictures
    if path.suffix == ".png":
        first.save(path)
        return
    lasts = [1000 / FRAMES] * len(others) + [1000 * HOLD]
    first.save(path, save_all=True, append_images=others, duration=lasts, loop=0)


def frames(steps: int, speed: float) -> list[int]:
    """Which steps are shown, the last one always."""
    apart = speed / FRAMES / PlaneParams().control_period
    shown = np.arange(0, steps - 1, apart).astype(int)
    return [*dict.fromkeys(shown.tolist()), steps - 1]


class View:
    """The picture of one moment of a run; `show` moves it to another."""

    def __init__(self, run: Watched, belief: np.ndarray, records: Records, title: str):
        """Draw what does not move."""
        self.run, self.belief = run, belief
        self.period = PlaneParams().control_period
        self.path = np.array([pose.robot[0, :2] for pose in run.poses])
        n_steps, n_records, longest = belief.shape
        with matplotlib.rc_context(
            {"font.size": 8, "axes.titlesize": 8, "axes.titlelocation": "left"}
        ):
            self.figure = Figure(figsize=(11, 5.4), dpi=80, layout="constrained")
            FigureCanvasAgg(self.figure)
            grid = GridSpec(3, 2, figure=self.figure, height_ratios=(1.3, 1.3, 1))
            self.figure.suptitle(title, fontsize=9)
            self.scene = Scene(plane := self.figure.add_subplot(grid[:2, 0]), PlaneParams())
            self.clock = plane.set_title("0.0 s")
            times = self.period * n_steps
            self.now = self._map(
                grid[0, 1], (longest // _BIN, n_records), longest * self.period,
                "belief p(I, τ) now, fourth root; bars: the records' ends", "moment τ, s",
            )  # fmt: skip
            self.ends = [
                self.now.axes.plot(2 * [length * self.period], [k - 0.5, k + 0.5], color="0.6")[0]
                for k, length in enumerate(np.asarray(records.lengths))
            ]
            self.past = self._map(
                grid[1, 1], (n_steps, n_records), times, "p(I) so far: the record followed", ""
            )
            self.stripes = belief.sum(axis=2).T
            self.lines = []
            self._curves(grid[2, 0], run.observations, _SENSORS, "sensors", times)
            self._curves(grid[2, 1], _scaled(run.commands), _COMMANDS, _SCALES, times)
        # Drawn once: all that stands still. What moves is drawn upon it for each picture.
        self.moving = [*self.scene.artists, self.clock, self.now, *self.ends, self.past]
        self.moving += [line for line, _ in self.lines]
        for image in (self.now, self.past):
            self.moving += image.axes.spines.values()
        for artist in self.moving:
            artist.set_animated(True)
        self.figure.canvas.draw()
        self.still = self.figure.canvas.copy_from_bbox(self.figure.bbox)

    def _map(self, where, shape: tuple[int, int], width: float, title: str, label: str):
        axes = self.figure.add_subplot(where)
        axes.set_title(title)
        axes.set_xlabel(label, labelpad=1)
        axes.set_ylabel("record I")
        return axes.imshow(
            np.zeros(shape[::-1]), aspect="auto", cmap="Greys", vmin=0, vmax=1, origin="lower",
            extent=(0, width, -0.5, shape[1] - 0.5), interpolation="nearest",
        )  # fmt: skip

    def _curves(self, where, values: np.ndarray, styles: tuple, title: str, times: float):
        axes = self.figure.add_subplot(where)
        axes.set_xlim(0, times)
        axes.set_ylim(-1.1, 1.1)
        axes.set_title(title)
        axes.set_xlabel("time, s", labelpad=1)
        # As many as there are: most studies have no light.
        for curve, (label, style) in zip(values.T, styles, strict=False):
            (line,) = axes.plot([], [], lw=1.2, label=label, **style)
            self.lines.append((line, curve))
        axes.legend(
            loc="center left", bbox_to_anchor=(1, 0.5), frameon=False, fontsize=7,
            labelspacing=0.3,
        )  # fmt: skip

    def show(self, t: int):
        """Show step t."""
        self.scene.update(self.run.poses[t], bool(self.run.held[t]), self.path[: t + 1])
        self.clock.set_text(f"{(t + 1) * self.period:.1f} s")
        n, longest = self.belief[t].shape
        whole = longest // _BIN * _BIN
        self.now.set_data(self.belief[t, :, :whole].reshape(n, -1, _BIN).sum(axis=2) ** 0.25)
        past = np.where(np.arange(self.stripes.shape[1]) <= t, self.stripes, 0)
        self.past.set_data(past)
        time = self.period * np.arange(1, t + 2)
        for line, values in self.lines:
            line.set_data(time, values[: t + 1])

    def picture(self) -> Image.Image:
        """What is shown, as a picture."""
        canvas = self.figure.canvas
        canvas.restore_region(self.still)
        for artist in self.moving:
            artist.axes.draw_artist(artist)
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).quantize(128)


_SENSORS = (
    ("camera", {"color": "black"}),
    *((f"proximeter {k}", {"color": matplotlib.colormaps["viridis"](k / 6)}) for k in range(6)),
    ("light", {"color": "black", "ls": "-."}),
)
_COMMANDS = (
    ("left track", {"color": "#1f4e79"}),
    ("right track", {"color": "#6fa8dc"}),
    ("elevation", {"color": "#b35900"}),
    ("tilt", {"color": "#7a4b94", "ls": "--"}),
    ("magnet", {"color": "black", "ls": ":"}),
)
_SCALES = "commands (tracks in 5 cm/s; gripper as a share of its travel)"


def _scaled(commands: np.ndarray) -> np.ndarray:
    """Commands as shares of what can be: tracks of 5 cm/s, the gripper of its travel."""
    p = PlaneParams()
    low = np.array([0, 0, p.low, 0, 0])
    span = np.array([0.05, 0.05, p.high - p.low, p.scanning_tilt, 1])
    return (commands - low) / span
