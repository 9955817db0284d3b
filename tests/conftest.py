import atexit
import os
import shutil
import tempfile

import jax
import numpy as np
import pytest
from hypothesis import settings

from jaxreplay.loop import tracker

jax.config.update("jax_numpy_rank_promotion", "raise")

settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")

os.environ["XDG_CACHE_HOME"] = cache = tempfile.mkdtemp(prefix="jaxreplay-tests-")
atexit.register(shutil.rmtree, cache, ignore_errors=True)

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


@pytest.fixture(scope="module")
def fewer_windows():
    """To compile less."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracker, "WINDOWS", (256,))
        yield
