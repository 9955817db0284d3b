"""An animation of one run: the plane, the belief, sensors and commands."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from jaxreplay.figures.view import View, which
from jaxreplay.study.dataset import Trace

FRAMES = 10  # per second of the animation
HOLD = 2  # s for which the last frame is shown
_GREYS = 64  # of the palette's 256 colours; the others are adapted to the frames


def title(run: Trace) -> str:
    """Return two lines: how the run ended, and which run it is."""
    return f"{run.ending}\n{which(run)}"


class Animation(NamedTuple):
    """An animation.

    Attributes:
        frames: pictures with one palette.
        durations: of the frames, ms.
    """

    frames: list[Image.Image]
    durations: list[float]

    def save(self, path: str | Path) -> None:
        """Save the animation as a GIF, repeated without end."""
        first, *others = self.frames
        first.save(
            path, "GIF", save_all=True, append_images=others, duration=self.durations, loop=0
        )


def animate(
    run: Trace, speed: float, progress: Callable[[int, int], None] = lambda done, total: None
) -> Animation:
    """Return an animation of a run.

    Args:
        run: the run.
        speed: as a multiple of real time.
        progress: called after each frame with the frames done and their total.
    """
    steps = frames(len(run.commands), speed, run.period)
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


def frames(steps: int, speed: float, period: float | None) -> list[int]:
    """Return the indices of the steps to show, the last among them; steps are `period` s apart.

    Where the period is not known, 10 steps are shown as one second.
    """
    apart = speed / FRAMES / (period or 1 / FRAMES)
    shown = np.arange(0, steps - 1, apart).astype(int)
    return [*dict.fromkeys(shown.tolist()), steps - 1]
