"""Worlds side by side: the physics of B robots and cubes, one pymunk space each.

One space a world, built at the origin in the same order, makes a world's outcome independent
of how many others are stepped beside it.
"""

import math
from collections.abc import Sequence

import numpy as np
import pymunk

from jaxreplay.plane.params import GRAVITY, PlaneParams
from jaxreplay.plane.sensors import PlaneState, camera, magnet_to_face, proximeters

_COLLIDES = pymunk.ShapeFilter()
_PASSES = pymunk.ShapeFilter(mask=0)
_AT_REST = 1e-4  # m/s, slower than any push


class _World:
    """One space: the robot driven through a velocity-matching joint, the cube rubbing the floor."""

    def __init__(self, params: PlaneParams, cube: np.ndarray):
        self.space = space = pymunk.Space()
        space.collision_slop = 0.0005  # m; pymunk's own, 0.1, is wider than the cube

        self.robot = pymunk.Body(params.mass, params.mass * params.hull_radius**2 / 2)
        hull = pymunk.Circle(self.robot, params.hull_radius)
        half = params.gripper_width / 2
        corners = [(x, y) for x in (0.0, params.reach) for y in (-half, half)]
        self.gripper = pymunk.Poly(self.robot, corners)

        self.cube = pymunk.Body(
            params.cube_mass, pymunk.moment_for_box(params.cube_mass, (params.side, params.side))
        )
        self.cube.position, self.cube.angle = (float(cube[0]), float(cube[1])), float(cube[2])
        box = pymunk.Poly.create_box(self.cube, (params.side, params.side))
        for shape in (hull, self.gripper, box):
            shape.friction = params.contact_friction**0.5  # pymunk multiplies the two

        # The tracks: match the velocity of a body moved at will, as far as traction goes.
        self.tracks = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        grip = params.traction * params.mass * GRAVITY
        drive = _rub(self.tracks, self.robot, grip, grip * params.track_separation / 2)

        # Coulomb friction on the floor; the mean lever of a square's area is 0.3826 sides.
        self.weight = params.floor_friction * params.cube_mass * GRAVITY
        self.lever = 0.3826 * params.side
        self.floor = _rub(space.static_body, self.cube, 0.0, 0.0)

        self.magnet = _rub(self.robot, self.cube, 0.0, 0.0)
        space.add(self.robot, hull, self.gripper, self.cube, box, self.tracks)
        space.add(*drive, *self.floor, *self.magnet)

    def hold(self, params: PlaneParams):
        """Fix the cube to the magnet as it stands."""
        pivot, gear = self.magnet
        pivot.anchor_a = (params.reach, 0.0)
        pivot.anchor_b = self.cube.world_to_local(self.robot.local_to_world((params.reach, 0.0)))
        gear.phase = self.cube.angle - self.robot.angle
        pivot.max_force = params.magnet_force
        gear.max_force = params.magnet_force * params.side / 2

    def release(self):
        """Let go of the cube."""
        for joint in self.magnet:
            joint.max_force = 0.0

    def rub_floor(self, lifted: bool):
        """Share the floor's friction between sliding and turning, as they share the motion.

        An ellipsoidal limit surface (Howe & Cutkosky, 1996): a cube that slides is turned by the
        slightest torque. _AT_REST keeps the shares defined, and equal, for one that does neither.
        """
        weight = 0.0 if lifted else self.weight
        slide = self.cube.velocity.length + _AT_REST
        spin = abs(self.cube.angular_velocity) * self.lever + _AT_REST
        both = math.hypot(slide, spin)
        self.floor[0].max_force = weight * slide / both
        self.floor[1].max_force = weight * self.lever * spin / both


def _rub(a: pymunk.Body, b: pymunk.Body, force: float, torque: float) -> tuple:
    """Joints that resist relative velocity up to a force and a torque, and hold no position."""
    joints = pymunk.PivotJoint(a, b, (0, 0), (0, 0)), pymunk.GearJoint(a, b, 0.0, 1.0)
    for joint, limit in zip(joints, (force, torque), strict=True):
        joint.max_bias = 0.0
        joint.max_force = limit
    return joints


class Plane:
    """B runs advancing together. Noise comes from a stream of each run's own.

    Attributes:
        params: the constants.
        state: the poses, see :class:`PlaneState`.
        alignment_error: `[B]` lateral distance from the magnet's centre to the centre of the
            face it holds, at the moment it took hold, m; NaN before.
    """

    def __init__(self, params: PlaneParams, cubes: np.ndarray, keys: Sequence[Sequence[int]]):
        """Place the robots at the origin and the cubes where told.

        Args:
            params: the constants, for all worlds.
            cubes: `[B, 3]` x, y (m) and angle (rad) of each cube.
            keys: B seeds, each a sequence of non-negative integers.
        """
        cubes = np.asarray(cubes, dtype=float)
        self.params = params
        self._worlds = [_World(params, cube) for cube in cubes]
        n = len(cubes)
        self.state = PlaneState(
            robot=np.zeros((n, 3)),
            cube=cubes.copy(),
            elevation=np.full(n, params.high),
            tilt=np.zeros(n),
            held=np.zeros(n, dtype=bool),
        )
        self.alignment_error = np.full(n, np.nan)
        self._side_seen = np.zeros(n)
        self._step = 0
        # Drawn ahead, so that a run's noise depends on nothing but its key and the step.
        shape = params.max_steps + 1, 2 + 7
        self._noise = np.empty((n, *shape))
        for noise, key in zip(self._noise, keys, strict=True):
            rng = np.random.default_rng(list(key))
            noise[:, :2] = rng.uniform(-1, 1, (shape[0], 2))
            noise[:, 2:] = rng.standard_normal((shape[0], 7))

    def observe(self) -> np.ndarray:
        """`[B, 7]` the cube's x in the image and six proximeters, with noise."""
        x = camera(self.params, self.state, self._side_seen)
        self._side_seen = np.sign(x)
        noise = self._noise[:, self._step, 2:]
        seen = np.concatenate(
            [
                x[:, None] + self.params.camera_noise * noise[:, :1],
                proximeters(self.params, self.state) + self.params.proximeter_noise * noise[:, 1:],
            ],
            axis=1,
        )
        return np.clip(seen, [-1] + 6 * [0], 1)

    def step(self, commands: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Carry out one control step in the worlds that are active, and observe.

        Args:
            commands: `[B, 5]` left and right track (motor units; the robot rounds to whole
                ones), elevation (m) and tilt (rad) set points, magnet (on above 0.5). Beyond an
                actuator's limits they are clipped.
            active: `[B]` which worlds to advance.

        Returns:
            `[B, 7]` observations after the step.
        """
        p, state = self.params, self.state
        limit = round(p.top_speed / p.motor_unit)
        units = np.clip(np.rint(commands[:, :2]), -limit, limit)
        speed = units * p.motor_unit * (1 + p.wheel_noise * self._noise[:, self._step, :2])
        forward = speed.mean(axis=1)
        turn = (speed[:, 1] - speed[:, 0]) / p.track_separation
        on = commands[:, 4] > 0.5

        elevation = _servo(state.elevation, commands[:, 2], p.low, p.high, p.elevation_speed, p)
        tilt = _servo(state.tilt, commands[:, 3], 0.0, p.scanning_tilt, p.tilt_speed, p)
        self.state = state._replace(
            elevation=np.where(active, elevation, state.elevation),
            tilt=np.where(active, tilt, state.tilt),
        )
        lifted = self.lifted
        for b in np.flatnonzero(active):
            self._advance(b, forward[b], turn[b], lifted[b])
        self._hold(active & on)
        for b in np.flatnonzero(active & ~on & self.state.held):
            self._worlds[b].release()
            self.state.held[b] = False
        self._step += 1
        return self.observe()

    @property
    def lifted(self) -> np.ndarray:
        """`[B]` whether the cube is held off the floor."""
        return self.state.held & (self.state.elevation >= self.params.low + self.params.lift)

    @property
    def outside(self) -> np.ndarray:
        """`[B]` whether the robot's hull crosses the border of the area."""
        (x, y), r = self.state.robot[:, :2].T, self.params.hull_radius
        x0, x1, y0, y1 = self.params.area
        return (x - r < x0) | (x + r > x1) | (y - r < y0) | (y + r > y1)

    def _advance(self, b: int, forward: float, turn: float, lifted: bool):
        p, world = self.params, self._worlds[b]
        heading = world.robot.angle
        world.tracks.velocity = forward * np.cos(heading), forward * np.sin(heading)
        world.tracks.angular_velocity = turn
        above = self.state.elevation[b] - p.low > p.side
        world.gripper.filter = _PASSES if above and not self.state.held[b] else _COLLIDES
        for _ in range(p.substeps):
            world.rub_floor(lifted)
            world.space.step(p.control_period / p.substeps)
        self.state.robot[b] = *world.robot.position, world.robot.angle
        self.state.cube[b] = *world.cube.position, world.cube.angle

    def _hold(self, on: np.ndarray):
        """Let magnets that are on, down and turned ahead take hold of what they touch."""
        p, state = self.params, self.state
        ready = on & ~state.held & (state.tilt < p.grasping_tilt)
        ready &= state.elevation < p.low + p.side / 2
        gap, lateral, angle = magnet_to_face(p, state)
        ready &= (gap < p.magnet_gap) & (gap > -p.side / 2)
        ready &= (np.abs(lateral) < p.magnet_offset) & (np.abs(angle) < p.magnet_angle)
        for b in np.flatnonzero(ready):
            self._worlds[b].hold(p)
            state.held[b] = True
            self.alignment_error[b] = abs(lateral[b])


def _servo(now, target, low, high, speed, params):
    """A position after one control step towards a set point at constant speed."""
    reach = speed * params.control_period
    return now + np.clip(np.clip(target, low, high) - now, -reach, reach)
