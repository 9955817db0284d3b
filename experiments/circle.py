"""Point robots that drive laps around a circle and leave to a goal, and their demonstrations.

Used by `loop.py`. A robot's sensors, its position and a lamp, are the same in every lap.
"""

from typing import NamedTuple

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from jaxreplay import Records

N, LONGEST = 8, 400  # records and samples of each: one shape, so one compiled program
PERIOD, RADIUS, LAP = 0.1, 0.5, 30  # s, m, samples a lap at the usual speed
SPEED = 2 * np.pi * RADIUS / (LAP * PERIOD)  # m/s
GOAL, ARRIVED, AREA = 1.5, 0.2, 2.5  # m
SENSOR_NOISE, MOTOR_NOISE = 0.02, 0.1 * SPEED  # standard deviations a step: m, m/s
STEPS = 420  # of a run, within which the robot must reach the goal


class Shown(NamedTuple):
    """What the demonstrations show."""

    laps: tuple[int, ...]  # one after the other in the records
    speeds: float = 0.1  # relative range of speeds around the usual one
    starts: float = 0.2  # range of starts around where the circle is left, rad
    lamp: bool = False  # whether a lamp is lit half a lap before leaving


class Circle(VectorEnv):
    """Point robots on the complex plane, driven by velocity; each sees its position and a lamp."""

    metadata = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012 - as in Gymnasium

    def __init__(self, slots: int):
        """Make `slots` robots."""
        self.num_envs = slots
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,))
        self.single_action_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,))
        self.position = np.ones(slots, complex)
        self.angle, self.off, self.t, self.held = np.zeros((4, slots))
        self.disturbed, self.resting = np.zeros((2, slots), bool)
        self.noise = np.zeros((slots, STEPS, 4))

    def reset(self, *, seed, options):
        """Place robots near the circle, `start` rad after where it is left."""
        for b in np.flatnonzero(options["reset_mask"]):
            self.resting[b] = seed[b] is None
            if not self.resting[b]:
                rng = np.random.default_rng(seed[b])
                self.noise[b] = options["noise"][b] * rng.normal(size=(STEPS, 4))
                self.angle[b], self.held[b] = options["start"][b], options["held"][b]
                self.position[b] = RADIUS * rng.uniform(0.9, 1.1) * np.exp(1j * self.angle[b])
                self.t[b], self.off[b], self.disturbed[b] = 0, 0, False
        self.options = options
        return np.zeros((self.num_envs, 3)), {}

    def step(self, actions):
        """Drive a step.

        The info contains `laps` around the centre, `arrived` (at the goal), and `off`, the largest
        distance from the circle so far, before the last half lap, in m.
        """
        now = np.minimum(self.t, STEPS - 1).astype(int)
        noise = self.noise[np.arange(self.num_envs), now]
        half_way = self.angle >= 3 * np.pi
        held = half_way & (self.held > 0)
        carried = np.where(half_way & ~self.disturbed, 2 * np.pi * self.options["carried"], 0)
        self.held -= held
        self.disturbed |= half_way
        velocity = (actions + MOTOR_NOISE * noise[:, :2]) @ [1, 1j]
        moved = self.position + PERIOD * np.where(held, 0, velocity)
        self.angle += np.angle(moved / self.position) + carried
        self.position = moved * np.exp(1j * carried)
        self.t += 1

        distance = np.abs(self.position)
        last = self.angle >= 2 * np.pi * (self.options["wanted"] - 0.5)
        self.off = np.where(last, self.off, np.maximum(self.off, np.abs(distance - RADIUS)))
        x, y = self.position.real, self.position.imag
        seen = np.stack([x, y, last & self.options["lamp"]], axis=1)
        seen[:, :2] += SENSOR_NOISE * noise[:, 2:]
        arrived = np.abs(self.position - GOAL) < ARRIVED
        over = arrived | (distance > AREA)
        info = {"laps": self.angle / (2 * np.pi), "arrived": arrived, "off": self.off}
        return seen, np.zeros(len(seen)), over, self.t >= STEPS, info


def options(n: int, **given) -> dict[str, np.ndarray]:
    """Return reset options `[n]` of n runs; those not given have their usual value."""
    usual = {"start": 0.0, "noise": 1.0, "held": 0, "carried": 0.0}
    return {name: np.broadcast_to(value, n) for name, value in (usual | given).items()}


def demonstrate(shown: Shown, rng: np.random.Generator) -> Records:
    """Record laps and the way to the goal N times, each until all have `LONGEST` samples."""
    laps = np.resize(shown.laps, N)
    speed = SPEED * (1 + shown.speeds * rng.uniform(-1, 1, N))
    start = shown.starts * rng.uniform(-1, 1, N)
    env, left = Circle(N), np.zeros(N, bool)
    given = options(N, start=start, wanted=laps, lamp=shown.lamp)
    seeds = rng.integers(2**32, size=N)
    env.reset(seed=seeds, options=given | {"reset_mask": np.ones(N, bool)})
    sensors, commands = np.zeros((N, LONGEST, 3)), np.zeros((N, LONGEST, 2))
    for t in range(LONGEST):
        distance, way = np.abs(env.position), GOAL - env.position
        around = speed * env.position / distance * (1j + 2 * (1 - distance / RADIUS))
        ahead = way / np.abs(way) * np.minimum(speed, np.abs(way) / PERIOD / 2)
        left |= env.angle >= 2 * np.pi * laps
        command = np.where(left, ahead, around)
        commands[:, t] = np.stack([command.real, command.imag], axis=1)
        sensors[:, t], *_ = env.step(commands[:, t])
    return Records.from_sequences(list(sensors), list(commands), period=PERIOD)
