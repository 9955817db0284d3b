"""The filter run step by step beside the reference, and how far they may differ."""

from typing import NamedTuple

import jax
import numpy as np
import pytest
from random_helpers import as_float32

from jaxreplay import Params, Records, reference
from jaxreplay.filter import READINGS

PRECISIONS = ("float32", "float64")
COMPILE_QUICKLY = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}

both_readings = pytest.mark.parametrize("jump", READINGS)
# For tests that take long to compile: the printed reading runs only with `-m slow`.
own_tau_first = pytest.mark.parametrize(
    "jump", ["own_tau", pytest.param("same_tau", marks=pytest.mark.slow)]
)
both_precisions = pytest.mark.parametrize("precision", PRECISIONS)


class Case(NamedTuple):
    """Records, a replay's observations, and parameters: values that float32 represents exactly."""

    sensors: list[np.ndarray]
    commands: list[np.ndarray]
    zs: np.ndarray
    theta_i: float
    theta_tau: float
    sigma: np.ndarray


def case(sensors, zs, sigma, theta_i=0.1, theta_tau=0.05):
    """A case with random commands in [−1, 1]."""
    rng = np.random.default_rng(len(zs))
    commands = [as_float32(rng.uniform(-1, 1, (len(s), 2))) for s in sensors]
    thetas = (float(np.float32(theta)) for theta in (theta_i, theta_tau))
    return Case([as_float32(s) for s in sensors], commands, as_float32(zs), *thetas, sigma)


def x64(precision="float64"):
    return jax.enable_x64(precision == "float64")


def noise(seed, *shape):
    return np.random.default_rng(seed).normal(size=shape)


def passing(record, sigma, steps, seed=0):
    """Noisy observations along a record, one sample a step, its last sample until the end."""
    at = np.minimum(np.arange(steps), len(record) - 1)
    return record[at] + sigma * noise(seed, steps, len(sigma))


def run(f, sequences, zs, params):
    """Posterior, command, log evidence and end probability after every step; the last belief."""
    records = Records.from_sequences(*sequences)
    belief, steps = f.init(records), []
    for z in zs:
        belief = f.predict(records, params, belief)
        u = f.command(records, belief)
        belief, log_evidence = f.update(records, params, belief, z)
        end = f.end_probability(records, belief)
        steps.append((f.posterior(records, belief), u, log_evidence, end))
    return [np.array(values) for values in zip(*steps, strict=True)], belief


def run_reference(sequences, zs, theta_i, theta_tau, sigma, jump):
    """What :func:`run` returns first, of the reference."""
    sensors, commands = sequences
    params = reference.Params(theta_i, theta_tau, sigma)
    belief, steps = reference.init(sensors), []
    for z in zs:
        belief = reference.predict(sensors, params, belief, jump)
        u = reference.command(commands, belief)
        belief, log_evidence = reference.update(sensors, params, belief, z)
        end = reference.end_probability(sensors, belief)
        steps.append((np.exp(belief), u, log_evidence, end))
    return [np.array(values) for values in zip(*steps, strict=True)]


def tolerance(sensors, zs, sigma, precision="float32"):
    """`[T]` allowed error of probabilities, and of commands of order 1, after each step.

    It grows with the number of steps, and with the largest distance so far, in σ, of a sensor's
    observation from all its samples.
    """
    if precision == "float64":
        return np.full(len(zs), 1e-9)
    samples = np.concatenate(sensors)
    away = [np.nan_to_num(np.abs(samples - z).min(0) / sigma).max() for z in zs]
    return 1e-5 + 1e-6 * (np.maximum.accumulate(away) + np.arange(1, len(zs) + 1))


def far_tolerance(sensors, zs, sigma):
    """`[T]` the error that rounding may add to the log odds of two records by each step.

    2^-23 D² a step: D is the distance from the observation to the sample nearest to it of the
    record for which that is farthest, in σ (the root of the sum of squares over the sensors).
    """
    squares = [
        max(((((samples - z) / sigma) ** 2).sum(1)).min() for samples in sensors) for z in zs
    ]
    return 2.0**-23 * np.cumsum(squares)


def errors(got, want, tolerance, precision="float32", more=0.0):
    """The largest error of each result of :func:`run`, divided by the allowed error.

    For a log evidence, 10^-4 (float32) of its magnitude is allowed, or of 1 where that is larger;
    and `more`, `[T]` or a number, for all.
    """
    relative = {"float32": 1e-4, "float64": 1e-9}[precision]
    found = {}
    for name, a, b in zip(("posterior", "command", "evidence", "end"), got, want, strict=True):
        allowed = (tolerance + more).reshape(-1, *[1] * (b.ndim - 1))
        if name == "evidence":
            allowed = relative * np.maximum(np.abs(b), 1) + more
        found[name] = float(np.max(np.abs(a - b) / allowed))
    return found


def assert_agree(got, want, tolerance, precision="float32", more=0.0):
    found = errors(got, want, tolerance, precision, more)
    assert all(error <= 1 for error in found.values()), found


def params_of(case):
    return Params(case.theta_i, case.theta_tau, case.sigma)
