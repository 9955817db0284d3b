"""Pictures of the plane from above, drawn with matplotlib."""

from collections.abc import Sequence

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
_VIEW = 0.6  # length of the lines that bound the camera's view, m


class Scene:
    """A picture of one world on given axes, in cm.

    Attributes:
        params: the constants.
        artists: the parts that :meth:`update` changes.
    """

    def __init__(self, axes: Axes, params: PlaneParams):
        """Draw the experimental area; :meth:`update` places robot and cube."""
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
        self._beams = LineCollection([], color=_BEAM, lw=0.6)
        self._cube = Polygon(np.zeros((4, 2)), fc=_CUBE, ec="black", lw=0.8)
        self._hull = Circle((0, 0), 100 * params.hull_radius, fc=_HULL, ec="black")
        self._gripper = Polygon(np.zeros((4, 2)), ec="black", lw=0.8)
        axes.add_collection(self._beams)
        for patch in (self._cube, self._hull, self._gripper):
            axes.add_patch(patch)
        (self._heading,) = axes.plot([], [], color="black", lw=1)
        self.artists = (
            self._view, self._trail, self._beams, self._cube, self._hull, self._gripper,
            self._heading,
        )  # fmt: skip

    def update(self, pose: Pose, held: bool, trail: np.ndarray) -> None:
        """Show a world.

        Args:
            pose: of one world, `[1, …]` each.
            held: whether the magnet holds the cube; its edge is then drawn thick.
            trail: `[T, 2]` past positions of the robot, m.
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
        edge_x, edge_y = _VIEW * np.cos(p.field_of_view / 2), _VIEW * np.sin(p.field_of_view / 2)
        edges = [(edge_x, -edge_y), (0.0, 0.0), (edge_x, edge_y)]
        self._view.set_data(*_placed(pose.robot[0], edges).T)
        x, y, angle = rays = proximeter_rays(p, pose)
        distance = ray_to_square(*rays, pose.cube, p.side)[0]
        # A beam that points up is drawn as long as it looks from above.
        shown = np.cos(min(p.scanning_tilt - pose.tilt[0], np.pi / 2))
        length = shown * np.minimum(distance, p.proximeter_range)
        starts = np.stack([x[0], y[0]])
        ends = starts + length * np.stack([np.cos(angle[0]), np.sin(angle[0])])
        self._beams.set_segments(list(100 * np.stack([starts, ends]).transpose(2, 0, 1)))


def picture(params: PlaneParams, pose: Pose, held: bool) -> np.ndarray:
    """Return a picture of one world from above, `[H, W, 3]` uint8.

    Args:
        params: the constants.
        pose: of one world, `[1, …]` each.
        held: whether the magnet holds the cube.
    """
    figure = Figure(figsize=(5, 3.8), dpi=80, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    Scene(figure.add_subplot(), params).update(pose, held, pose.robot[:, :2])
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _placed(frame: np.ndarray, points: Sequence[tuple[float, float]]) -> np.ndarray:
    """Return points given in a frame (x, y, angle; m, rad) as `[n, 2]` on the plane, in cm."""
    x, y, angle = frame
    cos, sin = np.cos(angle), np.sin(angle)
    return 100 * (np.array(points) @ np.array([[cos, sin], [-sin, cos]]) + [x, y])
