"""A scripted teacher that acts from the same 7 sensor values the replay will have.

It does what § 3 lists: orient towards the cube, bring the gripper into scanning position, advance
until close, refine the orientation, turn the gripper back, and fetch the cube. Speeds, pauses and
thresholds are drawn anew for each demonstration, as a person's would differ.
"""

from collections.abc import Generator

import numpy as np

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import seed_of
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams
from jaxreplay.records import Records

# Where cubes stand, m from the robot's start. The paper's figure shows 20 demonstrated and 5 test
# positions, 25–40 cm ahead and ±10 cm aside, but gives no coordinates: a grid is an assumption, and
# so is that a cube is laid down with a face towards the robot's start (see `facing`).
DEMONSTRATED = np.array(
    [(x, y) for x in np.linspace(0.25, 0.40, 4) for y in np.linspace(-0.1, 0.1, 5)]
)
TESTED = np.array(
    [(0.275, -0.075), (0.275, 0.025), (0.325, 0.075), (0.375, -0.025), (0.375, 0.075)]
)
SPANNING = (0, 4, 7, 12, 15, 19)  # six of the demonstrated that span them


def facing(positions: np.ndarray) -> np.ndarray:
    """Cubes `[B, 3]` at positions `[B, 2]`, a face of each turned to the robot's start."""
    positions = np.asarray(positions, dtype=float)
    return np.column_stack([positions, np.arctan2(positions[:, 1], positions[:, 0])])


Teacher = Generator[np.ndarray, np.ndarray, None]


def teacher(params: PlaneParams, rng: np.random.Generator) -> Teacher:
    """Yields commands `[5]` and is sent observations `[7]`; speeds within are motor units."""
    offsets = np.asarray(params.proximeter_offsets)
    hand = np.array([params.high, 0.0, 0.0])  # elevation, tilt, magnet
    seen = np.zeros(7)

    def act(left: float, right: float) -> Teacher:
        nonlocal seen
        seen = yield np.array([left * params.motor_unit, right * params.motor_unit, *hand])

    def wait(shortest: float, longest: float) -> Teacher:
        for _ in range(round(rng.uniform(shortest, longest) / params.control_period)):
            yield from act(0, 0)

    def drive(speed: int, seconds: float) -> Teacher:
        for _ in range(round(seconds / params.control_period)):
            yield from act(speed, speed)

    def aside() -> float:
        """How far to the left the proximeters see the cube, m; 0 when they do not."""
        near = np.expm1(100 * params.proximeter_range * seen[1:])  # as bright as it is near
        return float(offsets @ near / near.sum()) if near.any() else 0.0

    def turn_until(error, tolerance: float, fast: int, slow_below: float) -> Teacher:
        """Turn to the left while the error is positive; done when it stayed small.

        Patience wears off: the tolerance doubles in 4 s.
        """
        calm = 0
        while calm < 5:
            e = error()
            tolerance *= 2 ** (params.control_period / 4)
            speed = 0 if abs(e) < tolerance else fast if abs(e) > slow_below else 1
            calm = 0 if speed else calm + 1
            yield from act(-speed * np.sign(e), speed * np.sign(e))

    def advance_until(reading: float, speed: int, steer, tolerance: float) -> Teacher:
        while seen[1:].max() < reading:
            e = steer()
            correction = int(np.sign(e)) if abs(e) > tolerance else 0
            yield from act(speed - max(correction, 0), speed - max(-correction, 0))

    turning, cruising, creeping = (int(rng.integers(*span)) for span in ((1, 4), (2, 4), (1, 3)))
    yield from wait(2, 8)
    # orient towards the cube
    yield from turn_until(lambda: -seen[0], rng.uniform(0.02, 0.05), turning, 0.15)
    yield from wait(2, 6)
    # change the position of the gripper to scan it
    hand[:2] = params.low, params.scanning_tilt
    yield from wait(4, 9)
    # advance until close enough
    yield from advance_until(rng.uniform(0.3, 0.5), cruising, lambda: -seen[0], 0.04)
    yield from wait(2, 6)
    # refine the orientation, from further and from closer
    yield from turn_until(aside, rng.uniform(0.0015, 0.0025), 1, 1.0)
    yield from advance_until(rng.uniform(0.65, 0.75), 1, aside, 0.004)
    yield from turn_until(aside, rng.uniform(0.001, 0.0015), 1, 1.0)
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


def record(params: PlaneParams, positions: np.ndarray, seed: int) -> tuple[Records, np.ndarray]:
    """Demonstrate once at each position `[N, 2]`, all side by side.

    Returns:
        The records, and their alignment errors `[N]` in m.

    Raises:
        RuntimeError: a demonstration failed, or did not end within the time limit: a replay
            could learn nothing from it.
    """
    n = len(positions)
    worlds = PlaneVectorEnv(n, params)
    seeds = [seed_of(seed, i) for i in range(n)]
    worlds.reset(seed=seeds, options={"cube": facing(positions)})
    teachers = [teacher(params, np.random.default_rng([s, 2])) for s in seeds]
    commands = np.array([next(acting) for acting in teachers])
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
    sensors, sent = zip(*(map(np.array, zip(*row, strict=True)) for row in rows), strict=True)
    records = Records.from_sequences(
        sensors, sent, SENSOR_NAMES, COMMAND_NAMES, params.control_period
    )
    return records, worlds.alignment_error.copy()
