"""A trace of a run that nobody did, for tests of what shows one."""

import numpy as np

from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES
from jaxreplay.records import Records
from jaxreplay.study.dataset import PlaneScene, Trace

STEPS = 90


def trace():
    """A robot that turns and drives, and takes hold of its cube; three records."""
    rng, t = np.random.default_rng(0), np.linspace(0, 1, STEPS)
    beliefs = rng.random((STEPS, 3, 80)) ** 20
    return Trace(
        observations=rng.uniform(0, 1, (STEPS, 7)),
        commands=np.column_stack([0.01 * t, 0.02 * t, 0.03 + 0.05 * t, t, t > 0.5]),
        beliefs=beliefs / beliefs.sum(axis=(1, 2), keepdims=True),
        records=Records.from_sequences(
            [rng.uniform(0, 1, (n, 7)) for n in (80, 60, 70)],
            [np.zeros((n, 5)) for n in (80, 60, 70)],
            SENSOR_NAMES,
            COMMAND_NAMES,
        ),
        ending="S, error 2.3 mm",
        period=0.1,
        scene=PlaneScene(
            robot=np.column_stack([0.2 * t, 0.05 * t, 0.3 * t]),
            cube=np.column_stack([0.3 + 0 * t, 0.1 * t, 0 * t]),
            elevation=0.03 + 0.05 * t,
            tilt=t,
            held=t > 0.5,
        ),
        values={"θ_I": 0.001, "J": "own_tau"},
        place="position 3, repeat 1",
    )
