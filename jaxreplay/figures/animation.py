"""An animation of one run: the plane, the belief, sensors and commands."""

from base64 import b64encode
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from PIL import Image

from jaxreplay.figures.table import short
from jaxreplay.plane.drawing import Scene
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.sensors import Pose
from jaxreplay.study.dataset import Trace

FRAMES = 10  # per second of the animation
HOLD = 2  # s for which the last frame is shown
# Moments τ (positions on a record) whose probabilities are added up in one pixel of the belief.
_BIN = 4
_GREYS = 64  # of the palette's 256 colours; the others are adapted to the frames


Styles = tuple[tuple[str, dict[str, Any]], ...]  # a label and a line's style each


def title(run: Trace) -> str:
    """Return two lines: how the run ended, and which run it is."""
    return f"{ending(run)}\n{which(run)}"


def ending(run: Trace) -> str:
    """Return how a run ended."""
    ended = f"{run.outcome}{f' ({run.stall})' if run.stall else ''}"
    if run.outcome == "S":
        ended += f", error {1e3 * run.alignment_error:.1f} mm"
    return ended


def which(run: Trace) -> str:
    """Return which run of a study it is: the factors' values, position and repeat."""
    values = [f"{symbol} {short(value)}" for symbol, value in run.values.items()]
    return f"{', '.join(values)}; position {run.position}, repeat {run.repeat}"


class Animation(NamedTuple):
    """An animation, which a notebook shows.

    Attributes:
        frames: pictures with one palette.
        durations: of the frames, ms.
    """

    frames: list[Image.Image]
    durations: list[float]

    def save(self, path: str | Path | BytesIO) -> None:
        """Save the animation as a GIF, repeated without end."""
        first, *others = self.frames
        first.save(
            path, "GIF", save_all=True, append_images=others, duration=self.durations, loop=0
        )

    def _repr_html_(self) -> str:
        file = BytesIO()
        self.save(file)
        return f'<img src="data:image/gif;base64,{b64encode(file.getvalue()).decode()}">'


def animate(
    run: Trace, speed: float, progress: Callable[[int, int], None] = lambda done, total: None
) -> Animation:
    """Return an animation of a run.

    Args:
        run: the run.
        speed: as a multiple of real time.
        progress: called after each frame with the frames done and their total.
    """
    steps = frames(len(run.commands), speed, run.plane.control_period)
    view, pictures = View(run), []

    def shown(t: int) -> Image.Image:
        view.show(t)
        return view.picture()

    # All frames have the colours of a few, so that no colour changes as it plays.
    few = [np.asarray(shown(steps[k * (len(steps) - 1) // 3])) for k in range(4)]
    palette = _palette(np.vstack(few))
    for t in steps:
        pictures.append(_reduced(shown(t), palette))
        progress(len(pictures), len(steps))
    return Animation(pictures, [1000 / FRAMES] * (len(pictures) - 1) + [1000 * HOLD])


def _palette(pixels: np.ndarray) -> Image.Image:
    """Return a picture whose palette suits `[H, W, 3]` pixels: evenly spaced greys, then colours.

    A palette made of all pixels has few pure greys, and would tint the light ones.
    """
    coloured = pixels[~_is_grey(pixels)][None]
    number = 256 - _GREYS
    colours = Image.fromarray(coloured).quantize(number, Image.Quantize.MAXCOVERAGE).getpalette()
    greys = np.linspace(0, 255, _GREYS).round().astype(int).repeat(3)
    picture = Image.new("P", (1, 1))
    picture.putpalette([*greys.tolist(), *(colours or [])[: 3 * number]])
    return picture


def _reduced(picture: Image.Image, palette: Image.Image) -> Image.Image:
    """Return a picture in the colours of `_palette`, in which grey pixels remain grey."""
    reduced = picture.quantize(palette=palette, dither=Image.Dither.NONE)
    pixels, indices = np.asarray(picture), np.array(reduced)
    grey = _is_grey(pixels)
    indices[grey] = np.rint(pixels[grey, 0] * ((_GREYS - 1) / 255))
    result = Image.fromarray(indices)
    result.putpalette(reduced.getpalette() or [])
    return result


def _is_grey(pixels: np.ndarray) -> np.ndarray:
    """Return for `[H, W, 3]` pixels whether each has three equal components, `[H, W]`."""
    return (pixels[..., 0] == pixels[..., 1]) & (pixels[..., 1] == pixels[..., 2])


def still(run: Trace) -> Image.Image:
    """Return a picture of the last step of a run, in all its colours."""
    view = View(run)
    view.show(len(run.commands) - 1)
    return view.picture()


def frames(steps: int, speed: float, period: float) -> list[int]:
    """Return the indices of the steps to show, the last among them; steps are `period` s apart."""
    apart = speed / FRAMES / period
    shown = np.arange(0, steps - 1, apart).astype(int)
    return [*dict.fromkeys(shown.tolist()), steps - 1]


class View:
    """The picture of one step of a run, drawn with `picture`; `show` chooses the step."""

    def __init__(self, run: Trace):
        """Draw what is the same in all steps."""
        self.run = run
        self.period = run.plane.control_period
        n_steps, n_records, longest = run.beliefs.shape
        with matplotlib.rc_context(
            {"font.size": 8, "axes.titlesize": 8, "axes.titlelocation": "left"}
        ):
            self.figure = Figure(figsize=(11, 5.4), dpi=120, layout="constrained")
            self.canvas = FigureCanvasAgg(self.figure)
            grid = GridSpec(3, 2, figure=self.figure, height_ratios=(1.3, 1.3, 1))
            self.figure.suptitle(fill(which(run), 150), fontsize=9)
            self.scene = Scene(plane := self.figure.add_subplot(grid[:2, 0]), run.plane)
            self.clock = plane.set_title("0.0 s")
            times = self.period * n_steps
            self.now = self._map(
                grid[0, 1], (longest // _BIN, n_records), longest * self.period,
                "belief p(I, τ) now, fourth root; bars: the records' ends", "moment τ, s",
            )  # fmt: skip
            self.ends = [
                self.now.axes.plot(2 * [length * self.period], [k - 0.5, k + 0.5], color="0.6")[0]
                for k, length in enumerate(run.lengths)
            ]
            self.past = self._map(
                grid[1, 1], (n_steps, n_records), times, "p(I) so far: the record followed", ""
            )
            self.stripes = run.beliefs.sum(axis=2).T
            self.lines: list[tuple[Line2D, np.ndarray]] = []
            self._curves(
                grid[2, 0], _shares(run.observations), _SENSORS,
                "sensors, each from its lowest to its highest value in the run", times,
            )  # fmt: skip
            self._curves(grid[2, 1], _scaled(run.plane, run.commands), _COMMANDS, _SCALES, times)
        # The background, all that does not change, is drawn once: a picture takes 35 ms, not 250.
        self.moving: list[Artist] = [*self.scene.artists, self.clock, self.now, *self.ends]
        self.moving.append(self.past)
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
        return axes.imshow(
            np.zeros(shape[::-1]), aspect="auto", cmap="Greys", vmin=0, vmax=1, origin="lower",
            extent=(0, width, -0.5, shape[1] - 0.5), interpolation="nearest",
        )  # fmt: skip

    def _curves(
        self, where: SubplotSpec, values: np.ndarray, styles: Styles, title: str, end: float
    ) -> None:
        """Add a panel of curves up to the time `end`, for the columns of values `[T, n]`."""
        axes = self.figure.add_subplot(where)
        axes.set_xlim(0, end)
        axes.set_ylim(min(0, values.min()) - 0.1, 1.1)
        axes.set_title(title)
        axes.set_xlabel("time, s", labelpad=3)
        # Not strict: the last style is the light's, a sensor that most studies do not have.
        for curve, (label, style) in zip(values.T, styles, strict=False):
            (line,) = axes.plot([], [], lw=1.2, label=label, **style)
            self.lines.append((line, curve))
        axes.legend(
            loc="center left", bbox_to_anchor=(1, 0.5), frameon=False, fontsize=7,
            labelspacing=0.3,
        )  # fmt: skip

    def show(self, t: int) -> None:
        """Change the picture to step t."""
        run, at = self.run, slice(t, t + 1)
        pose = Pose(run.robot[at], run.cube[at], run.elevation[at], run.tilt[at])
        self.scene.update(pose, bool(run.held[t]), run.robot[: t + 1, :2])
        clock = f"{(t + 1) * self.period:.1f} s"
        self.clock.set_text(f"{clock}: {ending(run)}" if t + 1 == len(run.commands) else clock)
        n, longest = run.beliefs[t].shape
        whole = longest // _BIN * _BIN
        self.now.set_data(run.beliefs[t, :, :whole].reshape(n, -1, _BIN).sum(axis=2) ** 0.25)
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


_SENSORS: Styles = (
    ("camera", {"color": "black"}),
    *((f"proximeter {k}", {"color": matplotlib.colormaps["viridis"](k / 6)}) for k in range(6)),
    ("light", {"color": "black", "ls": "-."}),
)
_COMMANDS: Styles = (
    ("left track", {"color": "#1f4e79"}),
    ("right track", {"color": "#6fa8dc", "ls": (0, (4, 4))}),  # often equal to the left's
    ("elevation", {"color": "#b35900"}),
    ("tilt", {"color": "#7a4b94", "ls": "--"}),
    ("magnet", {"color": "black", "ls": ":"}),
)
_SCALES = "commands (tracks in units of 5 cm/s; gripper as a share of its travel)"


def _shares(values: np.ndarray) -> np.ndarray:
    """Return columns `[T, n]` as shares of their ranges; a constant one is 0."""
    low, span = values.min(axis=0), np.ptp(values, axis=0)
    return (values - low) / np.where(span > 0, span, 1)


def _scaled(p: PlaneParams, commands: np.ndarray) -> np.ndarray:
    """Return commands `[T, 5]` as shares: of 5 cm/s for tracks, of its travel for the gripper."""
    low = np.array([0, 0, p.low, 0, 0])
    span = np.array([0.05, 0.05, p.high - p.low, p.scanning_tilt, 1])
    return (commands - low) / span
