"""The plane from above, drawn with matplotlib."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.sensors import Pose, proximeter_rays, ray_to_square

_HULL, _GRIPPER, _CUBE, _TRAIL, _BEAM = "#9aa5b1", "#4a5568", "#e0b05a", "#1f4e79", "#c0504d"


class Scene:
    """Axes that show one world; `update` moves what moves, which is `artists`."""

    def __init__(self, axes: Axes, params: PlaneParams):
        """Draw the area; nothing moves yet."""
        self.params = params
        x0, x1, y0, y1 = (100 * v for v in params.area)
        axes.set_aspect("equal")
        axes.set_xlim(x0 - 2, x1 + 2)
        axes.set_ylim(y0 - 2, y1 + 2)
        axes.set_xlabel("ahead, cm")
        axes.set_ylabel("to the left, cm")
        axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, color="0.6", ls="--"))
        (self._trail,) = axes.plot([], [], color=_TRAIL, lw=1)
        (self._view,) = axes.plot([], [], color="0.8", lw=0.8)
        self._beams = axes.add_collection(LineCollection([], color=_BEAM, lw=0.6))
        self._cube = axes.add_patch(Polygon(np.zeros((4, 2)), fc=_CUBE, ec="black", lw=0.8))
        self._hull = axes.add_patch(Circle((0, 0), 100 * params.hull_radius, fc=_HULL, ec="black"))
        self._gripper = axes.add_patch(Polygon(np.zeros((4, 2)), ec="black", lw=0.8))
        (self._heading,) = axes.plot([], [], color="black", lw=1)
        self.artists = (
            self._view, self._trail, self._beams, self._cube, self._hull, self._gripper,
            self._heading,
        )  # fmt: skip

    def update(self, pose: Pose, held: bool, trail: np.ndarray):
        """Show a world.

        Args:
            pose: of one world, `[1, …]` each.
            held: whether the cube is held; it is then marked by a thick edge.
            trail: `[T, 2]` where the robot has been, m.
        """
        p = self.params
        x, y = pose.robot[0, :2]
        half = p.gripper_width / 2
        self._hull.center = 100 * x, 100 * y
        self._heading.set_data(*_placed(pose.robot[0], [(0, 0), (p.hull_radius, 0)]).T)
        self._gripper.set_xy(
            _placed(
                pose.robot[0],
                [(p.hull_radius, -half), (p.reach, -half), (p.reach, half), (p.hull_radius, half)],
            )
        )
        raised = (pose.elevation[0] - p.low) / (p.high - p.low)
        self._gripper.set_facecolor((*to_rgb(_GRIPPER), 1 - 0.7 * raised))
        s = p.side / 2
        self._cube.set_xy(_placed(pose.cube[0], [(-s, -s), (s, -s), (s, s), (-s, s)]))
        self._cube.set_linewidth(2.5 if held else 0.8)
        self._trail.set_data(*(100 * trail.T))
        far, half_view = 0.6, p.field_of_view / 2
        edges = [
            (far * np.cos(a), far * np.sin(a)) if a is not None else (0, 0)
            for a in (-half_view, None, half_view)
        ]
        self._view.set_data(*_placed(pose.robot[0], edges).T)
        rays = proximeter_rays(p, pose)
        *origin, angle = (a[0] for a in rays)
        distance = ray_to_square(*rays, pose.cube, p.side)[0]
        shown = np.cos(min(p.scanning_tilt - pose.tilt[0], np.pi / 2))  # beams up look short
        length = shown * np.minimum(distance, p.proximeter_range)
        ends = np.array(origin) + length * np.stack([np.cos(angle), np.sin(angle)])
        self._beams.set_segments(100 * np.stack([origin, ends]).transpose(2, 0, 1))


def picture(params: PlaneParams, pose: Pose, held: bool) -> np.ndarray:
    """One world from above, `[H, W, 3]` of bytes."""
    figure = Figure(figsize=(5, 3.8), dpi=80, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    Scene(figure.add_subplot(), params).update(pose, held, pose.robot[:, :2])
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _placed(frame: np.ndarray, points: list[tuple[float, float]]) -> np.ndarray:
    """Points in a frame (x, y, angle), in cm on the plane."""
    x, y, angle = frame
    cos, sin = np.cos(angle), np.sin(angle)
    points = np.array(points)
    return 100 * (points @ np.array([[cos, sin], [-sin, cos]]) + [x, y])
