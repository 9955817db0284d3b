"""Records of random walks, of one shape for most tests."""

import numpy as np

LENGTHS = (200, 31, 2, 1)  # one shape for most tests, so that JAX compiles once
N_SENSORS, N_COMMANDS = 2, 2


def as_float32(values):
    return np.asarray(values, np.float32).astype(np.float64)


def random_sequences(seed=0, lengths=LENGTHS, step=1.0):
    """Random walks that float32 holds exactly: N arrays of sensors and N of commands."""
    rng = np.random.default_rng(seed)
    sensors = [as_float32(step * rng.normal(size=(n, N_SENSORS)).cumsum(0)) for n in lengths]
    commands = [as_float32(rng.normal(size=(n, N_COMMANDS))) for n in lengths]
    return sensors, commands
