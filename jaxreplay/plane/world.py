"""The physics of one robot and its cube: a pymunk space, seen from above.

One space a world, built at the origin in the same order, makes a world's outcome independent
of how many others are stepped beside it. No Python runs between its physics steps.
"""

import numpy as np
import pymunk

from jaxreplay.plane.params import GRAVITY, PlaneParams

_COLLIDES = pymunk.ShapeFilter()
_PASSES = pymunk.ShapeFilter(mask=0)
_MEAN_LEVER = 0.3826  # of a square's area about its centre, in sides


class World:
    """The robot driven through a velocity-matching joint, the cube rubbing the floor."""

    def __init__(self, params: PlaneParams, cube: np.ndarray):
        """The robot at the origin, the cube at `[3]` x, y (m) and angle (rad)."""
        self.reach, self.side = params.reach, params.side
        self.period = params.control_period
        self.substeps = params.substeps
        self.space = space = pymunk.Space()
        # m; pymunk's own, 0.1, is wider than the cube. Found best at 5 substeps (0.02–0.5 mm).
        space.collision_slop = 0.0002

        self.robot = pymunk.Body(params.mass, params.mass * params.hull_radius**2 / 2)
        hull = pymunk.Circle(self.robot, params.hull_radius)
        half = params.gripper_width / 2
        corners = [(x, y) for x in (0.0, params.reach) for y in (-half, half)]
        self.gripper = pymunk.Poly(self.robot, corners)

        side, mass = params.side, params.cube_mass
        self.cube = pymunk.Body(mass, pymunk.moment_for_box(mass, (side, side)))
        self.cube.position, self.cube.angle = (float(cube[0]), float(cube[1])), float(cube[2])
        box = pymunk.Poly.create_box(self.cube, (side, side))
        for shape in (hull, self.gripper, box):
            shape.friction = params.contact_friction**0.5  # pymunk multiplies the two

        # The tracks: match the velocity of a body moved at will, as far as traction goes.
        self.tracks = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        grip = params.traction * params.mass * GRAVITY
        drive = (
            _resist(pymunk.PivotJoint(self.tracks, self.robot, (0, 0), (0, 0)), grip),
            _resist(
                pymunk.GearJoint(self.tracks, self.robot, 0.0, 1.0),
                grip * params.track_separation / 2,
            ),
        )

        # Coulomb friction on the floor, at four points that share the weight: sliding and
        # turning share the friction as they share the motion. Exact along the cube's sides and in
        # turning; askew some 5 % is lost to the points' pulling against each other.
        lever = _MEAN_LEVER * side
        self.rub = params.floor_friction * params.cube_mass * GRAVITY / 4
        self.floor = [
            _resist(pymunk.PivotJoint(space.static_body, self.cube, (0, 0), (x, y)), self.rub)
            for x, y in ((lever, 0), (0, lever), (-lever, 0), (0, -lever))
        ]

        # The joints of the magnet exist from the start, without force.
        self.magnet = (
            pymunk.PivotJoint(self.robot, self.cube, (self.reach, 0), (0, 0)),
            pymunk.GearJoint(self.robot, self.cube, 0.0, 1.0),
        )
        for joint in self.magnet:
            joint.error_bias = 0.1**60  # stiff: a share of the error is left after 1/60 s
        self.release()
        space.add(self.robot, hull, self.gripper, self.cube, box, self.tracks)
        space.add(*drive, *self.floor, *self.magnet)

    def raise_gripper(self, above: bool):
        """Let the gripper pass over the cube, or not."""
        self.gripper.filter = _PASSES if above else _COLLIDES

    def raise_cube(self, off_floor: bool):
        """Take the cube off the floor, or put it down."""
        for joint in self.floor:
            joint.max_force = 0.0 if off_floor else self.rub

    def hold(self, force: float, torque: float):
        """Draw the cube's face flush to the magnet, up to a force (N) and a torque (N m)."""
        pivot, gear = self.magnet
        x, y = self.cube.world_to_local(self.robot.local_to_world((self.reach, 0.0)))
        half = self.side / 2
        across = abs(x) > abs(y)  # the face's normal is the cube's x
        pivot.anchor_b = (np.copysign(half, x), y) if across else (x, np.copysign(half, y))
        turned = self.cube.angle - self.robot.angle
        gear.phase = np.round(turned / (np.pi / 2)) * np.pi / 2
        pivot.max_force, gear.max_force = force, torque

    def release(self):
        """Let go of the cube."""
        for joint in self.magnet:
            joint.max_force = 0.0


def _resist(joint: pymunk.Constraint, limit: float) -> pymunk.Constraint:
    """Make a joint resist relative velocity, up to a limit, and hold no position."""
    joint.max_bias = 0.0
    joint.max_force = limit
    return joint
