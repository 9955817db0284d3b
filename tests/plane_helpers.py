from dataclasses import replace

import numpy as np

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.params import NOMINAL, PlaneParams
from jaxreplay.plane.sensors import Pose

OLD = PlaneParams(**NOMINAL)  # a world in which every run is alike
EXACT = replace(OLD, wheel_noise=0.0, sensor_noise=0.0)
SUBSTEP = EXACT.control_period / EXACT.substeps  # a new velocity acts one substep late
UNIT, PERIOD = EXACT.motor_unit, EXACT.control_period
HIGH, LOW, SCAN = EXACT.high, EXACT.low, EXACT.scanning_tilt
AWAY = (0.6, 0.3, 0)  # a cube out of the way


def plane_with(*cubes, params=EXACT, **options):
    """Worlds with one cube each; an option is one value for all, or one for each."""
    n = len(cubes)
    env = PlaneVectorEnv(n, params)
    batched = {name: np.broadcast_to(value, n) for name, value in options.items()}
    env.reset(seed=list(range(n)), options=batched | {"cube": np.array(cubes, float)})
    return env


def send(env, command, seconds):
    """Send the same command to all worlds for some time; return the last step's results."""
    for _ in range(round(seconds / env.params.control_period)):
        result = env.step(np.tile(command, (env.num_envs, 1)))
    return result


def pose_of(robot=(0, 0, 0), cube=(0.3, 0, 0), elevation=LOW, tilt=SCAN):
    """One pose; any of its parts may be many, `[B, …]`."""
    robot, cube = (np.atleast_2d(np.asarray(v, float)) for v in (robot, cube))
    n = max(len(robot), len(cube))
    return Pose(
        np.broadcast_to(robot, (n, 3)),
        np.broadcast_to(cube, (n, 3)),
        np.broadcast_to(np.asarray(elevation, float), n),
        np.broadcast_to(np.asarray(tilt, float), n),
    )


def random_actions(rng, steps, n):
    """Random actions `[T, n, 5]`; set points and magnet are constant for 2 s each."""
    low, high = ([-0.05, -0.05, LOW, 0, 0], [0.1, 0.1, HIGH, SCAN, 1])
    actions = rng.uniform(low, high, (steps, n, 5))
    actions[:, :, 2:] = np.repeat(actions[::20, :, 2:], 20, axis=0)[:steps]
    return actions
