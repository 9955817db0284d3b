"""The picture of one step of a run: the world, the belief, sensors and commands."""

from collections.abc import Sequence
from io import BytesIO
from textwrap import fill
from typing import Any, Protocol

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image

from jaxreplay.figures.picture import literal
from jaxreplay.figures.table import short
from jaxreplay.plane.drawing import Scene
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.sensors import Pose
from jaxreplay.study.dataset import Pictures, PlaneScene, Trace

# Moments τ (positions on a record) whose probabilities are added up in one pixel of the belief.
_BIN = 4
_CURVES = 10  # sensors, or commands, that are drawn at most


def which(run: Trace) -> str:
    """Return which run of a study it is: the factors' values, position and repeat."""
    values = [f"{symbol} {short(value)}" for symbol, value in run.values.items()]
    return f"{', '.join(values)}; {run.place}"


class View:
    """The picture of one step of a run, drawn with `picture`; `show` chooses the step."""

    def __init__(self, run: Trace):
        """Draw what is the same in all steps."""
        self.run = run
        self.period, self.unit = (run.period, "s") if run.period else (1, "steps")
        n_steps, n_records, longest = run.beliefs.shape
        with matplotlib.rc_context(
            {"font.size": 8, "axes.titlesize": 8, "axes.titlelocation": "left"}
        ):
            self.figure = Figure(figsize=(11, 5.4), dpi=120, layout="constrained")
            self.canvas = FigureCanvasAgg(self.figure)
            grid = GridSpec(3, 2, figure=self.figure, height_ratios=(1.3, 1.3, 1))
            self.figure.suptitle(fill(literal(which(run)), 150), fontsize=9)
            self.lines: list[tuple[Line2D, np.ndarray]] = []
            sensors, past, commands = grid[2, 0], grid[1, 1], grid[2, 1]
            self.world = None
            if run.scene is None:  # then sensors are all that there is to see
                sensors, past, commands = grid[:2, 0], grid[1:, 1], grid[2, 0]
            else:
                self.world = _panel(self.figure.add_subplot(grid[:2, 0]), run.scene)
                self.clock = self.world.axes.set_title("")
            times = self.period * n_steps
            drove = run.values.get("controller", "filter") == "filter"
            aside = "" if drove else " of a filter, which did not drive"
            self.bin = max(1, min(_BIN, longest // 20))
            self.now = self._map(
                grid[0, 1], (longest // self.bin, n_records), longest * self.period,
                f"belief p(I, τ) now{aside}, fourth root; bars: the records' ends",
                f"moment τ, {self.unit}",
            )  # fmt: skip
            self.ends = [
                self.now.axes.plot(2 * [length * self.period], [k - 0.5, k + 0.5], color="0.6")[0]
                for k, length in enumerate(np.asarray(run.records.lengths))
            ]
            self.past = self._map(
                past, (n_steps, n_records), times, f"p(I) so far{aside}: the record followed", ""
            )
            self.stripes = run.beliefs.sum(axis=2).T
            each = "each from its lowest to its highest value in the run"
            if run.scene is None:  # beside the title stands the clock
                each = "each scaled to its range in the run"
            curves = _shares(run.observations), run.records.sensor_names
            axes = self._curves(sensors, *curves, f"sensors, {each}", times)
            if self.world is None:
                self.clock = axes.set_title("", loc="right")
            values, title = _shares(run.commands), f"commands, {each}"
            if isinstance(run.scene, PlaneScene):
                values, title = _scaled(run.scene.params, run.commands), _SCALES
            self._curves(commands, values, run.records.command_names, title, times)
        # The background, all that does not change, is drawn once: a picture takes 35 ms, not 250.
        self.moving: list[Artist] = [*(self.world.artists if self.world else ()), self.clock]
        self.moving += [self.now, *self.ends, self.past]
        self.moving += [line for line, _ in self.lines]
        for image in (self.now, self.past):
            self.moving += image.axes.spines.values()
        for artist in self.moving:
            artist.set_animated(True)
        self.canvas.draw()
        self.background = self.canvas.copy_from_bbox(self.figure.bbox)

    def _map(
        self, where: SubplotSpec, shape: tuple[int, int], width: float, title: str, label: str
    ) -> AxesImage:
        """Add an empty map of records by time, `shape` (columns, records), `width` s wide."""
        axes = self.figure.add_subplot(where)
        axes.set_title(title)
        axes.set_xlabel(label, labelpad=3)
        axes.set_ylabel("record I")
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        return axes.imshow(
            np.zeros(shape[::-1]), aspect="auto", cmap="Greys", vmin=0, vmax=1, origin="lower",
            extent=(0, width, -0.5, shape[1] - 0.5), interpolation="nearest",
        )  # fmt: skip

    def _curves(
        self, where: SubplotSpec, values: np.ndarray, names: Sequence[str], title: str, end: float
    ) -> Axes:
        """Add a panel of curves up to the time `end`, for the columns of values `[T, n]`."""
        axes = self.figure.add_subplot(where)
        axes.set_xlim(0, end)
        axes.set_ylim(min(0, values.min()) - 0.1, 1.1)
        more = f" ({_CURVES} of {len(names)})" if len(names) > _CURVES else ""
        axes.set_title(title + more)
        axes.set_xlabel(f"time, {self.unit}", labelpad=3)
        for k, (curve, name) in enumerate(zip(values.T[:_CURVES], names[:_CURVES], strict=True)):
            label, style = _STYLES.get(name, (name, _style(k, min(len(names), _CURVES))))
            (line,) = axes.plot([], [], lw=1.2, label=literal(label), **style)
            self.lines.append((line, curve))
        axes.legend(
            loc="center left", bbox_to_anchor=(1, 0.5), frameon=False, fontsize=7,
            labelspacing=0.3,
        )  # fmt: skip
        return axes

    def show(self, t: int) -> None:
        """Change the picture to step t."""
        run = self.run
        if self.world is not None:
            self.world.show(t)
        clock = f"{(t + 1) * self.period:.1f} s" if run.period else f"step {t + 1}"
        self.clock.set_text(f"{clock}: {run.ending}" if t + 1 == len(run.commands) else clock)
        n, longest = run.beliefs[t].shape
        whole = longest // self.bin * self.bin
        now = run.beliefs[t, :, :whole].reshape(n, -1, self.bin).sum(axis=2)
        self.now.set_data(now**0.25)
        past = np.where(np.arange(self.stripes.shape[1]) <= t, self.stripes, 0)
        self.past.set_data(past)
        time = self.period * np.arange(1, t + 2)
        for line, values in self.lines:
            line.set_data(time, values[: t + 1])

    def picture(self) -> Image.Image:
        """Return the picture of the step shown."""
        self.canvas.restore_region(self.background)
        for artist in self.moving:
            self.figure.draw_artist(artist)
        return Image.fromarray(np.asarray(self.canvas.buffer_rgba())[..., :3])


class _Panel(Protocol):
    """A panel that shows the world at a step."""

    axes: Axes

    @property
    def artists(self) -> Sequence[Artist]:
        """What changes from step to step."""
        ...

    def show(self, t: int) -> None:
        """Change the panel to step t."""
        ...


def _panel(axes: Axes, scene: PlaneScene | Pictures) -> _Panel:
    return _Plane(axes, scene) if isinstance(scene, PlaneScene) else _Frames(axes, scene)


class _Plane:
    """The plane from above."""

    def __init__(self, axes: Axes, scene: PlaneScene):
        self.axes, self._scene, self._drawn = axes, scene, Scene(axes, scene.params)
        self.artists = self._drawn.artists

    def show(self, t: int) -> None:
        scene, at = self._scene, slice(t, t + 1)
        pose = Pose(scene.robot[at], scene.cube[at], scene.elevation[at], scene.tilt[at])
        self._drawn.update(pose, bool(scene.held[t]), scene.robot[: t + 1, :2])


class _Frames:
    """The pictures that an environment gives."""

    def __init__(self, axes: Axes, scene: Pictures):
        self.axes, self._files = axes, scene.files
        axes.set_axis_off()
        self._image = axes.imshow(self._frame(0))
        self.artists = [self._image]

    def show(self, t: int) -> None:
        self._image.set_data(self._frame(t))

    def _frame(self, t: int) -> np.ndarray:
        return np.asarray(Image.open(BytesIO(self._files[t])))


_STYLES: dict[str, tuple[str, dict[str, Any]]] = {  # label and line of the plane's columns
    "camera": ("camera", {"color": "black"}),
    **{
        f"proximeter_{k}": (f"proximeter {k}", {"color": matplotlib.colormaps["viridis"](k / 6)})
        for k in range(6)
    },
    "light": ("light", {"color": "black", "ls": "-."}),
    "left_track": ("left track", {"color": "#1f4e79"}),
    "right_track": ("right track", {"color": "#6fa8dc", "ls": (0, (4, 4))}),  # often the left's
    "elevation": ("elevation", {"color": "#b35900"}),
    "tilt": ("tilt", {"color": "#7a4b94", "ls": "--"}),
    "magnet": ("magnet", {"color": "black", "ls": ":"}),
}
_SCALES = "commands (tracks in units of 5 cm/s; gripper as a share of its travel)"


def _style(k: int, n: int) -> dict[str, Any]:
    """Return the style of the k-th of n lines, which differ in lightness and in dashes."""
    colour = matplotlib.colormaps["viridis"](0.9 * k / max(n - 1, 1))
    return {"color": colour, "ls": ("-", "--", "-.", ":")[k % 4]}


def _shares(values: np.ndarray) -> np.ndarray:
    """Return columns `[T, n]` as shares of their ranges; a constant one is 0."""
    low, span = values.min(axis=0), np.ptp(values, axis=0)
    return (values - low) / np.where(span > 0, span, 1)


def _scaled(p: PlaneParams, commands: np.ndarray) -> np.ndarray:
    """Return commands `[T, 5]` as shares: of 5 cm/s for tracks, of its travel for the gripper."""
    low = np.array([0, 0, p.low, 0, 0])
    span = np.array([0.05, 0.05, p.high - p.low, p.scanning_tilt, 1])
    return (commands - low) / span
