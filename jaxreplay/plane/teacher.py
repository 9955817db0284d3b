"""A scripted teacher that demonstrates how to fetch the cube.

It acts on the same 7 sensor values that a replay has, in the phases that § 3 lists: orient towards
the cube, bring the gripper into scanning position, advance until close, refine the orientation,
turn the gripper back, and fetch the cube. Speeds, pauses and thresholds are drawn for each
demonstration, as a person's differ from one to the next.
"""

from collections.abc import Callable, Generator
from typing import NamedTuple

import numpy as np

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import seed_of
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import facing

Teacher = Generator[np.ndarray, np.ndarray, None]  # yields commands, is sent observations


def teacher(params: PlaneParams, rng: np.random.Generator) -> Teacher:
    """Yield commands `[5]`; the caller sends the observation `[7]` made after each.

    A command is the speeds of the left and right track (m/s), elevation (m), tilt (rad) and magnet
    (on above 0.5). The speeds are whole numbers of motor units, so the robot does not round them.

    Args:
        params: the constants.
        rng: draws speeds, pauses and thresholds.
    """
    offsets = np.asarray(params.proximeter_offsets)
    hand = np.array([params.high, 0.0, 0.0])  # elevation (m), tilt (rad), magnet
    seen = np.zeros(7)

    def act(left: float, right: float) -> Teacher:
        """Run the tracks for one control step at numbers of motor units, and observe."""
        nonlocal seen
        seen = yield np.array([left * params.motor_unit, right * params.motor_unit, *hand])

    def wait(shortest: float, longest: float) -> Teacher:
        """Stand still for a time drawn from a range, in s."""
        for _ in range(round(rng.uniform(shortest, longest) / params.control_period)):
            yield from act(0, 0)

    def drive(speed: int, seconds: float) -> Teacher:
        """Drive straight ahead."""
        for _ in range(round(seconds / params.control_period)):
            yield from act(speed, speed)

    def camera_error() -> float:
        """Return how far to the left the cube is in the image, −1 … 1."""
        return -seen[0]

    def lateral_error() -> float:
        """Return how far to the left the proximeters see the cube, m; 0 if they do not."""
        # Readings are linear in the distance. As weights they are turned back into infrared
        # responses, which grow exponentially, so that the beams on the nearest surface count most.
        near = np.expm1(100 * params.proximeter_range * seen[1:])
        return float(offsets @ near / near.sum()) if near.any() else 0.0

    def turn_until(
        error: Callable[[], float], tolerance: float, fast: int, slow_below: float
    ) -> Teacher:
        """Turn towards the side of the error until it stays within the tolerance for 5 steps.

        The tolerance doubles every 4 s, so that a turn ends even if the error cannot be made
        small.
        """
        calm = 0
        while calm < 5:
            e = error()
            tolerance *= 2 ** (params.control_period / 4)
            speed = 0 if abs(e) < tolerance else fast if abs(e) > slow_below else 1
            calm = 0 if speed else calm + 1
            yield from act(-speed * np.sign(e), speed * np.sign(e))

    def advance_until(
        reading: float, speed: int, error: Callable[[], float], tolerance: float
    ) -> Teacher:
        """Drive ahead, steering against the error, until a proximeter reaches the reading."""
        while seen[1:].max() < reading:
            e = error()
            correction = int(np.sign(e)) if abs(e) > tolerance else 0
            yield from act(speed - max(correction, 0), speed - max(-correction, 0))

    turning, cruising, creeping = (int(rng.integers(*span)) for span in ((1, 4), (2, 4), (1, 3)))
    yield from wait(2, 8)
    # orient towards the cube
    yield from turn_until(camera_error, rng.uniform(0.02, 0.05), turning, 0.15)
    yield from wait(2, 6)
    # change the position of the gripper to scan it
    hand[:2] = params.low, params.scanning_tilt
    yield from wait(4, 9)
    # advance until close enough
    yield from advance_until(rng.uniform(0.3, 0.5), cruising, camera_error, 0.04)
    yield from wait(2, 6)
    # refine the orientation, from further and from closer
    yield from turn_until(lateral_error, rng.uniform(0.0015, 0.0025), 1, 1.0)
    yield from advance_until(rng.uniform(0.65, 0.75), 1, lateral_error, 0.004)
    yield from turn_until(lateral_error, rng.uniform(0.001, 0.0015), 1, 1.0)
    yield from wait(2, 6)
    # turn the gripper back in the grasping position
    distance = (1 - seen[1:].max()) * params.proximeter_range
    hand[1] = 0.0
    yield from wait(3, 8)
    # fetch the cube
    hand[2] = 1.0
    speed = creeping * params.motor_unit
    yield from drive(creeping, (distance + rng.uniform(0.03, 0.04)) / speed)
    yield from wait(2, 5)
    hand[0] = params.high
    yield from wait(5, 9)


class Demonstrations(NamedTuple):
    """N demonstrations.

    Attributes:
        sensors: N arrays `[L_i, 7]`; row t was observed after the command of row t.
        commands: N arrays `[L_i, 5]`, in the units of :func:`teacher`.
        alignment_error: `[N]` lateral distances of the grasps from the faces' centres, m.
    """

    sensors: list[np.ndarray]
    commands: list[np.ndarray]
    alignment_error: np.ndarray


def demonstrate(params: PlaneParams, positions: np.ndarray, seed: int) -> Demonstrations:
    """Return demonstrations in which the teacher fetches the cube, one from each position.

    Args:
        params: the constants.
        positions: `[N, 2]` of the cube, m.
        seed: of all randomness in teacher and plane. A demonstration follows from the seed, its
            position and its index; it does not depend on the others.

    Raises:
        RuntimeError: a demonstration ended without the cube lifted.
    """
    n = len(positions)
    worlds = PlaneVectorEnv(n, params)
    seeds = [seed_of(seed, i) for i in range(n)]
    worlds.reset(seed=seeds, options={"cube": facing(positions)})
    teachers = [teacher(params, np.random.default_rng([s, 2])) for s in seeds]
    commands = np.array([next(each) for each in teachers])
    rows: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in range(n)]
    while not worlds.resting.all():
        going = np.flatnonzero(~worlds.resting)
        observations, *_ = worlds.step(commands)
        for i in going:
            rows[i].append((observations[i], commands[i].copy()))
            try:
                commands[i] = teachers[i].send(observations[i].astype(float))
            except StopIteration:
                worlds.resting[i] = True
    for i in np.flatnonzero(~worlds.lifted):
        x, y = positions[i]
        raise RuntimeError(f"the demonstration with the cube at ({x:.3f}, {y:.3f}) m failed")
    return Demonstrations(
        [np.array([observation for observation, _ in row]) for row in rows],
        [np.array([command for _, command in row]) for row in rows],
        worlds.alignment_error.copy(),
    )
