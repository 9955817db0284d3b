"""B worlds that advance together; pymunk simulates those in which something may touch or slip."""

import math

import numpy as np

from jaxreplay.plane.params import GRAVITY, PlaneParams
from jaxreplay.plane.sensors import Pose
from jaxreplay.plane.world import World

_CLEARANCE = 0.001  # m


class Worlds:
    """Slots for B worlds, empty at first.

    For most of a run the cube stands out of the robot's reach, and the robot moves as its tracks
    run. Then poses are computed here, for all such worlds at once, as pymunk would add them up (but
    for the rounding of its joints, 1e-16). pymunk's robot is put there when it is needed again. It
    may then solve the points of a contact in another order than if it had simulated everything,
    as it searches for them from where it last found some: a pushed cube turns by some 1e-3 rad more
    or less.
    """

    def __init__(self, params: PlaneParams, n: int):
        """Create n slots."""
        self._params = params
        self._worlds: dict[int, World] = {}
        self._step = params.control_period / params.substeps
        self._motion = np.zeros((n, 3))  # velocity and rate of robots at the end of a control step
        self._stands = np.zeros(n, bool)  # the cube
        self._behind = np.zeros(n, bool)  # pymunk's robot is not where the robot is
        # Centres further apart than this: robot and cube do not touch, however they are turned,
        # nor does the magnet hold it.
        corner = math.hypot(params.reach, params.gripper_width / 2)
        extent = max(corner, params.hull_radius) + params.side / 2**0.5
        self._apart = extent + params.magnet_gap + _CLEARANCE
        # The largest changes of velocity and of rate that tracks make in one physics step.
        self._faster = params.traction * GRAVITY * self._step
        self._turned = self._faster * params.track_separation / params.hull_radius**2  # of a disc

    def __len__(self) -> int:
        """Return how many slots have a world."""
        return len(self._worlds)

    def put(self, b: int, cube: np.ndarray, robot: np.ndarray) -> None:
        """Put a new world into slot b, with cube and robot at x, y (m) and angle (rad)."""
        self._worlds[b] = World(self._params, cube, robot)
        self._motion[b], self._stands[b], self._behind[b] = 0.0, True, False

    def of(self, mask: np.ndarray) -> list[tuple[int, World]]:
        """Return the slots in the mask `[B]`, each with its world."""
        return [(b, self._worlds[b]) for b in np.flatnonzero(mask).tolist()]

    def advance(self, mask: np.ndarray, forward: np.ndarray, turn: np.ndarray, pose: Pose) -> None:
        """Simulate one control step of the worlds in the mask `[B]`, and update their poses.

        Args:
            mask: the worlds.
            forward: `[B]` mean speed of the two tracks, m/s.
            turn: `[B]` rate at which the tracks turn the robot to the left, rad/s.
            pose: of all worlds; robots and cubes are moved in place.
        """
        heading = pose.robot[:, 2] + turn * self._params.control_period / 2  # the step's mean
        # By `math`, as NumPy's last digit may depend on how many worlds there are.
        cos, sin = (np.array([f(x) for x in heading.tolist()]) for f in (math.cos, math.sin))
        motion = np.stack([forward * cos, forward * sin, turn], axis=1)
        free = mask & self._free(motion, pose)
        robot = pose.robot + self._motion * self._step  # positions follow the velocity before
        for _ in range(self._params.substeps - 1):
            robot += motion * self._step
        pose.robot[free], self._motion[free] = robot[free], motion[free]
        self._behind |= free
        for b, world in self.of(mask & ~free):
            if self._behind[b]:
                world.place(pose.robot[b], self._motion[b])
            moved = world.advance(*motion[b].tolist())
            pose.robot[b], pose.cube[b] = moved[:3], moved[3:]
            self._motion[b], self._stands[b] = world.motion()
            self._behind[b] = False

    def _free(self, motion: np.ndarray, pose: Pose) -> np.ndarray:
        """Return in which worlds, `[B]`, physics would only move the robot as its tracks run.

        That is where the cube stands out of reach and the tracks grip.
        """
        x, y = (pose.cube - pose.robot)[:, :2].T
        change = np.abs(motion - self._motion)
        fastest = np.maximum(np.hypot(*motion[:, :2].T), np.hypot(*self._motion[:, :2].T))
        clear = np.hypot(x, y) - fastest * self._params.control_period > self._apart
        grip = np.hypot(*change[:, :2].T) < self._faster
        return self._stands & clear & grip & (change[:, 2] < self._turned)
