"""The filter run step by step beside the reference, and how far they may differ."""

from typing import NamedTuple

import jax
import numpy as np
import pytest
from conftest import as_float32

from jaxreplay import Params, Records, reference

READINGS = ("same_tau", "own_tau")
PRECISIONS = ("float32", "float64")
COMPILE_QUICKLY = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}

both_readings = pytest.mark.parametrize("jump", READINGS)
# For what takes long to compile: the reading that is told by the printed equation, if asked for.
own_tau_first = pytest.mark.parametrize(
    "jump", ["own_tau", pytest.param("same_tau", marks=pytest.mark.slow)]
)
both_precisions = pytest.mark.parametrize("precision", PRECISIONS)


class Case(NamedTuple):
    """Records, what a replay of them observes, and parameters: all as float32 holds them."""

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


def run(f, sequences, zs, params):
    """Posterior, command, log evidence and end probability after every step."""
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
    sensors, commands = sequences
    belief, steps = reference.initial(sensors), []
    for z in zs:
        belief = reference.predict(sensors, theta_i, theta_tau, belief, jump)
        u = reference.command(commands, belief)
        belief, log_evidence = reference.update(sensors, sigma, belief, z)
        end = reference.end_probability(sensors, belief)
        steps.append((np.exp(belief), u, log_evidence, end))
    return [np.array(values) for values in zip(*steps, strict=True)]


def tolerance(sensors, zs, sigma, precision="float32"):
    """`[T]` how far probabilities and commands of order 1 may be off after each step.

    It grows with the steps, and with the largest distance yet, in σ, of a sensor's observation
    from all its samples.
    """
    if precision == "float64":
        return np.full(len(zs), 1e-9)
    samples = np.concatenate(sensors)
    away = [np.nan_to_num(np.abs(samples - z).min(0) / sigma).max() for z in zs]
    return 1e-5 + 1e-6 * (np.maximum.accumulate(away) + np.arange(1, len(zs) + 1))


def errors(got, want, tolerance, precision="float32"):
    """The largest errors of :func:`run`, each as a share of what is allowed.

    A log evidence may be off by its 10^-4th part; where it passes through 0, within ±1, by 10^-4.
    """
    relative = {"float32": 1e-4, "float64": 1e-9}[precision]
    found = {}
    for name, a, b in zip(("posterior", "command", "evidence", "end"), got, want, strict=True):
        allowed = tolerance.reshape(-1, *[1] * (b.ndim - 1))
        if name == "evidence":
            allowed = relative * np.maximum(np.abs(b), 1)
        found[name] = float(np.max(np.abs(a - b) / allowed))
    return found


def assert_agree(got, want, tolerance, precision="float32"):
    found = errors(got, want, tolerance, precision)
    assert all(error <= 1 for error in found.values()), found


def params_of(case):
    return Params(case.theta_i, case.theta_tau, case.sigma)
