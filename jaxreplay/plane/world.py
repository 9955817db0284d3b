"""The physics of one robot and its cube: a pymunk space, seen from above.

Each world has a space of its own, built at the origin and in the same order, so that its outcome
does not depend on how many others are simulated beside it. pymunk calls no Python code during a
physics step.
"""

import numpy as np
import pymunk
from pymunk.constraints import Constraint, GearJoint, PivotJoint

from jaxreplay.plane.params import GRAVITY, PlaneParams

_COLLIDES = pymunk.ShapeFilter()
_PASSES = pymunk.ShapeFilter(mask=0)
_MEAN_LEVER = 0.3826  # mean distance of a square's points from its centre, in sides


class World:
    """A robot driven by joints that match a velocity, and a cube with friction on the floor.

    Attributes:
        robot: the robot's body; `robot.position` in m, `robot.angle` in rad.
        cube: the cube's body, likewise.
    """

    def __init__(
        self,
        params: PlaneParams,
        cube: np.ndarray | tuple[float, float, float],
        robot: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0),
    ):
        """Put cube and robot at x, y (m) and angle (rad), `[3]` each."""
        self._reach, self._side = params.reach, params.side
        self._period = params.control_period
        self._substeps = params.substeps
        self._space = space = pymunk.Space()
        # m. pymunk's default, 0.1, is wider than the cube. Of 0.02–0.5 mm this is the most
        # accurate at 5 substeps.
        space.collision_slop = 0.0002

        self.robot = pymunk.Body(params.mass, params.mass * params.hull_radius**2 / 2)
        self.robot.position, self.robot.angle = (float(robot[0]), float(robot[1])), float(robot[2])
        hull = pymunk.Circle(self.robot, params.hull_radius)
        half = params.gripper_width / 2
        corners = [(x, y) for x in (0.0, params.reach) for y in (-half, half)]
        self._gripper = pymunk.Poly(self.robot, corners)

        side, mass = params.side, params.cube_mass
        self.cube = pymunk.Body(mass, pymunk.moment_for_box(mass, (side, side)))
        self.cube.position, self.cube.angle = (float(cube[0]), float(cube[1])), float(cube[2])
        box = pymunk.Poly.create_box(self.cube, (side, side))
        for shape in (hull, self._gripper, box):
            # pymunk multiplies the friction of the two shapes.
            shape.friction = params.contact_friction**0.5

        # `_tracks` moves as the tracks run. The robot matches its velocity, as far as traction
        # allows.
        self._tracks = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        self._tracks.position, self._tracks.angle = self.robot.position, self.robot.angle
        grip = params.traction * params.mass * GRAVITY
        drive = (
            _resist(PivotJoint(self._tracks, self.robot, (0, 0), (0, 0)), grip),
            _resist(
                GearJoint(self._tracks, self.robot, 0.0, 1.0),
                grip * params.track_separation / 2,
            ),
        )

        # Coulomb friction on the floor, at four points that share the weight, so that sliding and
        # turning share the friction as they share the motion. It is exact for sliding along the
        # cube's sides and for turning. In oblique directions it is some 5 % too low, because the
        # points pull against each other.
        lever = _MEAN_LEVER * side
        per_point = params.floor_friction * params.cube_mass * GRAVITY / 4  # N
        self._friction_per_point = per_point
        self._floor = [
            _resist(PivotJoint(space.static_body, self.cube, (0, 0), (x, y)), per_point)
            for x, y in ((lever, 0), (0, lever), (-lever, 0), (0, -lever))
        ]

        # The magnet's joints exist from the start, without force: none is added during a run.
        self._magnet = (
            PivotJoint(self.robot, self.cube, (self._reach, 0), (0, 0)),
            GearJoint(self.robot, self.cube, 0.0, 1.0),
        )
        for joint in self._magnet:
            joint.error_bias = 0.1**60  # stiff: a tenth of the error is left after 1/60 s
        self.release()
        space.add(self.robot, hull, self._gripper, self.cube, box, self._tracks)
        space.add(*drive, *self._floor, *self._magnet)

    def advance(self, x: float, y: float, turn: float) -> tuple[float, ...]:
        """Simulate one control step.

        Args:
            x: velocity at which the tracks move the robot along x, m/s.
            y: the same along y.
            turn: rate at which they turn it to the left, rad/s.

        Returns:
            x, y (m) and angle (rad) of the robot, then of the cube.
        """
        robot, cube, tracks = self.robot, self.cube, self._tracks
        tracks.velocity, tracks.angular_velocity = (x, y), turn
        for _ in range(self._substeps):
            self._space.step(self._period / self._substeps)
        return *robot.position, robot.angle, *cube.position, cube.angle

    def place(self, pose: np.ndarray, motion: np.ndarray) -> None:
        """Put the robot at x, y (m) and angle (rad), moving at m/s, m/s and rad/s, `[3]` each."""
        x, y, self.robot.angle = pose.tolist()
        self.robot.position = x, y
        x, y, self.robot.angular_velocity = motion.tolist()
        self.robot.velocity = x, y

    def motion(self) -> tuple[tuple[float, ...], bool]:
        """Return the robot's velocity (m/s, m/s) and rate (rad/s), and whether the cube stands."""
        robot, cube = self.robot, self.cube
        stands = cube.velocity == (0.0, 0.0) and cube.angular_velocity == 0.0
        return (*robot.velocity, robot.angular_velocity), stands

    def set_gripper_above(self, above: bool) -> None:
        """Let the gripper pass over the cube if it is above it; else let the two collide."""
        self._gripper.filter = _PASSES if above else _COLLIDES

    def set_cube_off_floor(self, off_floor: bool) -> None:
        """Switch the floor's friction off while the cube is off the floor, else on."""
        for joint in self._floor:
            joint.max_force = 0.0 if off_floor else self._friction_per_point

    def attach(self, force: float, torque: float) -> None:
        """Hold the cube's face flush with the magnet, up to a force (N) and a torque (N m)."""
        pivot, gear = self._magnet
        x, y = self.cube.world_to_local(self.robot.local_to_world((self._reach, 0.0)))
        half = self._side / 2
        across = abs(x) > abs(y)  # the face's normal is the cube's x
        pivot.anchor_b = (np.copysign(half, x), y) if across else (x, np.copysign(half, y))
        turned = self.cube.angle - self.robot.angle
        gear.phase = np.round(turned / (np.pi / 2)) * np.pi / 2
        pivot.max_force, gear.max_force = force, torque

    def release(self) -> None:
        """Stop holding the cube."""
        for joint in self._magnet:
            joint.max_force = 0.0


def _resist(joint: Constraint, limit: float) -> Constraint:
    """Return a joint that resists relative velocity up to a limit (N, N m), not displacement."""
    joint.max_bias = 0.0
    joint.max_force = limit
    return joint
