"""How many control steps a second does the plane simulate on one core, against plain loops?

`python experiments/benchmarks/plane_step.py` prints a table: for 1, 16 and 128 worlds the
control steps of one world that fit into a second, sensors included, and ratios to the plain
loop. Medians of several rounds, in which the rivals take turns.

- **plain loop**: world after world in Python: pymunk's attributes written and read, `Space.step`
  called, servos and camera computed with scalars, proximeters by pymunk's own segment queries
  (`Space.segment_query_first`), a ray at a time.
- **plain loop, our sensors**: the same, but the sensors of all worlds computed at once.
- **jaxreplay**: `PlaneVectorEnv.step`, which asks pymunk only where something may touch or slip.

All rivals step the same spaces at the same substep; their observations after 6 s are compared
first. (Later some differ by 0.005, see `jaxreplay.plane.worlds`.)
"""

import math
import resource
import statistics
import time

import numpy as np
import pymunk

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.params import NOMINAL, PlaneParams
from jaxreplay.plane.sensors import Pose, camera, proximeters
from jaxreplay.plane.world import World

STEPS, COMPARED, ROUNDS, WIDTHS = 120, 60, 7, (1, 16, 128)
P = PlaneParams(**NOMINAL | {"wheel_noise": 0.0, "sensor_noise": 0.0})
CUBE_ONLY = pymunk.ShapeFilter(mask=1)
COMMAND = (0.015, 0.015, P.low, P.scanning_tilt, 0.0)  # advances, scanning


def cubes(n: int) -> np.ndarray:
    """Return where cubes stand, some of them in the robot's way."""
    rng = np.random.default_rng(0)
    return rng.uniform([0.24, -0.05, -1], [0.3, 0.08, 1], (n, 3))


class Plain:
    """Worlds stepped one after the other."""

    def __init__(self, n: int, vectorised: bool):
        """Make n worlds; their sensors are computed all at once if `vectorised`."""
        self.worlds = [World(P, cube) for cube in cubes(n)]
        self.vectorised = vectorised
        self.hand = [[P.high, 0.0, None] for _ in range(n)]
        for world in self.worlds:
            for shape in world.robot.shapes:
                shape.filter = pymunk.ShapeFilter(categories=2)
            for shape in world.cube.shapes:
                shape.filter = pymunk.ShapeFilter(categories=1)
        self.seen = np.zeros(n)

    def step(self) -> np.ndarray:
        """Do a control step in every world, and return the observations."""
        rows = [self.one(b) for b in range(len(self.worlds))]
        if not self.vectorised:
            return np.array([self.look(b) for b in range(len(self.worlds))])
        robot, cube, elevation, tilt = (np.array(x) for x in zip(*rows, strict=True))
        pose = Pose(robot, cube, elevation, tilt)
        self.seen = camera(P, pose, self.seen)
        return np.column_stack([self.seen, proximeters(P, pose)])

    def one(self, b: int) -> tuple:
        """Do a control step of one world."""
        world, hand = self.worlds[b], self.hand[b]
        left, right = (round(v / P.motor_unit) * P.motor_unit for v in COMMAND[:2])
        forward, turn = (left + right) / 2, (right - left) / P.track_separation
        running = P.control_period - (P.servo_restart if hand[2] != COMMAND[2:4] else 0)
        hand[2] = COMMAND[2:4]
        for k, speed in ((0, P.elevation_speed), (1, P.tilt_speed)):
            hand[k] += max(-speed * running, min(speed * running, COMMAND[2 + k] - hand[k]))
        heading = world.robot.angle + turn * P.control_period / 2
        world._tracks.velocity = forward * math.cos(heading), forward * math.sin(heading)
        world._tracks.angular_velocity = turn
        solid = hand[0] - P.head < P.side
        world._gripper.filter = pymunk.ShapeFilter(categories=2, mask=0xFFFFFFFF if solid else 0)
        for _ in range(P.substeps):
            world._space.step(P.control_period / P.substeps)
        robot, cube = world.robot, world.cube
        return (*robot.position, robot.angle), (*cube.position, cube.angle), hand[0], hand[1]

    def look(self, b: int) -> list[float]:
        """Return the observation of one robot."""
        world, (elevation, tilt, _) = self.worlds[b], self.hand[b]
        robot = world.robot
        x, y = robot.world_to_local(world.cube.position)
        along, half = P.reach / x, P.image_width / 2
        sight = P.camera_height - (P.camera_height - P.side / 2) * along
        hidden = along < 1 and abs(y * along) < P.gripper_width / 2
        image = -y / x / math.tan(P.field_of_view / 2)
        if x > 0 and abs(image) <= 1 and not (hidden and abs(sight - elevation) < P.head):
            self.seen[b] = round(image * half) / half
        readings = [self.seen[b]]
        pitch = P.scanning_tilt - tilt
        for offset in P.proximeter_offsets:
            received = 0.0
            start = robot.local_to_world((P.reach, offset))
            for k in range(P.beam_rays):
                angle = robot.angle + P.beam_half_angle * (2 * k / (P.beam_rays - 1) - 1)
                end = (
                    start[0] + P.proximeter_range * math.cos(angle),
                    start[1] + P.proximeter_range * math.sin(angle),
                )
                hit = world._space.segment_query_first(start, end, 0, CUBE_ONLY)
                if hit is None or pitch > P.beam_steepest:
                    continue
                distance = hit.alpha * P.proximeter_range
                if 0 <= elevation + distance * math.tan(pitch) <= P.side:
                    cm = 100 * distance / math.cos(pitch)
                    received += 3000 - 440 * cm if cm < 0.5 else 4526 * math.exp(-0.9994 * cm)
            counts = round(received / P.beam_rays)
            if counts > 2780:
                cm = (3000 - min(counts, 3000)) / 440
            else:
                cm = max(math.log(4526 / counts) / 0.9994, 0.5) if counts else math.inf
            readings.append(max(1 - cm / (100 * P.proximeter_range), 0))
        return readings


def ours(n: int):
    """Return a function that steps n of our worlds."""
    env = PlaneVectorEnv(n, P)
    env.reset(seed=0, options={"cube": cubes(n)})
    actions = np.tile(COMMAND, (n, 1))
    return lambda: env.step(actions)[0]


RIVALS = {
    "plain loop": lambda n: Plain(n, vectorised=False).step,
    "plain loop, our sensors": lambda n: Plain(n, vectorised=True).step,
    "jaxreplay": ours,
}


def observations() -> dict[str, np.ndarray]:
    """Return what each rival observes in 16 worlds after `COMPARED` steps, `[16, 7]`."""
    steps = {name: make(16) for name, make in RIVALS.items()}
    for _ in range(COMPARED):
        seen = {name: step() for name, step in steps.items()}
    return seen


def main():
    """Compare observations, measure, and print the table."""
    seen = observations()
    for name, observed in seen.items():
        np.testing.assert_allclose(observed, seen["jaxreplay"], atol=1e-3, err_msg=name)

    print(f"{P.substeps} physics steps a control step; thousand control steps of a world a second")
    print(f"{'worlds':>8}" + "".join(f"{name:>26}" for name in RIVALS))
    for n in WIDTHS:
        taken = {name: [] for name in RIVALS}
        for _ in range(ROUNDS):
            for name, make in RIVALS.items():
                step = make(n)
                start = time.perf_counter()
                for _ in range(STEPS):
                    step()
                taken[name].append(time.perf_counter() - start)
        rates = {name: n * STEPS / statistics.median(t) / 1e3 for name, t in taken.items()}
        cells = (f"{rate:.1f} (×{rate / rates['plain loop']:.2f})" for rate in rates.values())
        print(f"{n:8d}" + "".join(f"{cell:>26}" for cell in cells))

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    kept = ours(2000)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    kept()
    print(f"memory a world: {grown / 2000:.0f} KiB")


if __name__ == "__main__":
    main()
