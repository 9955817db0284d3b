"""Records such as a user may have, and scores of parameters on them by the reference."""

from contextlib import contextmanager

import jax
import numpy as np
import pytest
from filter_helpers import COMPILE_QUICKLY
from random_helpers import random_sequences

from jaxreplay import Params, reference
from jaxreplay.recordings import optimise

LENGTHS = (100, 110, 95, 105, 98, 102)


def sequences(lengths=LENGTHS, seed=0, scale=1.0):
    """A path there and back, noise, and something that comes into range and goes again.

    The last 12 rows are at rest, if there are more than 20.
    """
    rng = np.random.default_rng(seed)
    sensors, commands = [], []
    for n in lengths:
        t = np.minimum(np.arange(n) / max(n - 12, 9), 1)
        seen = np.where(np.abs(t - 0.5) < 0.2 + 0.05 * rng.random(), 0.6 + rng.random(n) / 20, 0)
        z = np.stack([np.sin(3 * t + rng.random()), rng.normal(size=n), seen], 1)
        sensors.append(scale * (z + 0.01 * rng.normal(size=(n, 3)) * [1, 1, 0]))
        commands.append(np.stack([np.cos(3 * t), t > rng.uniform(0.4, 0.6)], 1))
    return sensors, commands


# Of the records that parameters are tuned on: one shape for all, so that JAX compiles once.
TUNED_LENGTHS = (60, 52, 44)
SIGMA = np.array([0.5, 2.0])
GRID = Params(  # five sets of parameters wherever scores are taken, for the same reason
    [0.125, 0.5, 0.0625, 0.25, 0.75],
    [0.0625, 0.25, 0.125, 0.5, 0.0],
    np.array([1, 2, 0.5, 4, 1])[:, None] * SIGMA,
)


def walks():
    """Three walks that begin alike, so that one may be followed by means of the others.

    The last of three commands never changes.
    """
    sensors, commands = random_sequences(3, TUNED_LENGTHS, step=0.25)
    common = np.cumsum(np.ones((max(TUNED_LENGTHS), 2)), axis=0) / 8
    sensors = [s + common[: len(s)] for s in sensors]
    return sensors, [np.column_stack([c, np.full(len(c), 7)]) for c in commands]


def far_from_zero(sequences):
    """The same at positions such as UTM coordinates, for which records have an offset."""
    sensors, commands = sequences
    return [s + np.array([500_000.0, 5_000_000.0]) for s in sensors], commands


def expected(sequences, i, params, jump):
    """Log evidence of record i, and its squared command errors `[T, 2]`, by the reference."""
    span = np.ptp(np.concatenate(sequences[1]), axis=0)
    sensors, commands = ([x for k, x in enumerate(part) if k != i] for part in sequences)
    belief, total, squares = reference.init(sensors), 0.0, []
    for z, v in zip(sequences[0][i], sequences[1][i], strict=True):
        belief = reference.predict(sensors, params, belief, jump)
        squares.append(((reference.command(commands, belief) - v)[:2] / span[:2]) ** 2)
        belief, gained = reference.update(sensors, params, belief, z)
        total += gained
    return total, np.array(squares)


@contextmanager
def gradient_compiled_quickly():
    """The gradient takes longer to compile than all else takes to run."""
    compiled = jax.jit(
        optimise._gradient.__wrapped__, static_argnames="jump", compiler_options=COMPILE_QUICKLY
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(optimise, "_gradient", compiled)
        yield
