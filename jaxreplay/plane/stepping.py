"""A control step of one world, by pymunk's public calls or straight by its C functions.

The second does the same calls without pymunk's Python around each, and the whole plane steps
1.3 times as fast for it (experiments/benchmarks/plane_step.py). Those functions are private to
pymunk: where they are not found, the public ones do.
"""

import math
from typing import Protocol

import pymunk

try:
    from pymunk._chipmunk_cffi import lib

    _NEEDED = (
        (pymunk.Body(), "_body"),
        (pymunk.Space(), "_space"),
        (lib, "cpSpaceStep"),
        (lib, "cpBodyGetAngle"),
        (lib, "cpBodyGetPosition"),
        (lib, "cpBodySetVelocity"),
        (lib, "cpBodySetAngularVelocity"),
    )
    _FOUND = all(hasattr(what, name) for what, name in _NEEDED)
except ImportError:
    _FOUND = False


class Steppable(Protocol):
    """What a world must have: bodies, its space, and how it is stepped."""

    robot: pymunk.Body
    cube: pymunk.Body
    tracks: pymunk.Body
    space: pymunk.Space
    period: float
    substeps: int


def advance_public(world: Steppable, forward: float, turn: float) -> tuple[float, ...]:
    """One control step with the tracks running at a speed (m/s) and a turning rate (rad/s).

    Returns:
        x, y and angle of the robot and of the cube.
    """
    robot, cube, tracks = world.robot, world.cube, world.tracks
    heading = robot.angle + turn * world.period / 2  # the mean over the step
    tracks.velocity = forward * math.cos(heading), forward * math.sin(heading)
    tracks.angular_velocity = turn
    step, dt = world.space.step, world.period / world.substeps
    for _ in range(world.substeps):
        step(dt)
    return *robot.position, robot.angle, *cube.position, cube.angle


def advance_private(world: Steppable, forward: float, turn: float) -> tuple[float, ...]:
    """The same."""
    robot, cube, tracks = world.robot._body, world.cube._body, world.tracks._body
    heading = lib.cpBodyGetAngle(robot) + turn * world.period / 2
    lib.cpBodySetVelocity(tracks, (forward * math.cos(heading), forward * math.sin(heading)))
    lib.cpBodySetAngularVelocity(tracks, turn)
    step, space, dt = lib.cpSpaceStep, world.space._space, world.period / world.substeps
    for _ in range(world.substeps):
        step(space, dt)
    a, b = lib.cpBodyGetPosition(robot), lib.cpBodyGetPosition(cube)
    return a.x, a.y, lib.cpBodyGetAngle(robot), b.x, b.y, lib.cpBodyGetAngle(cube)


advance = advance_private if _FOUND else advance_public
