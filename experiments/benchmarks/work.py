"""The work on which `filter_step.py` measures its rivals, and how exact they must be."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxreplay import reference

THETA_I, THETA_TAU, SIGMA = 0.01, 0.05, 0.1


class Work(NamedTuple):
    """N records of one length, and observations along the first of them.

    Attributes:
        sensors: `[N, L, n_s]` float64, exact in float32 as all values here.
        commands: `[N, L, n_u]`.
        observations: `[T, B, n_s]` for B replays, each with noise of its own.
        jump: the reading of a jump.
    """

    sensors: np.ndarray
    commands: np.ndarray
    observations: np.ndarray
    jump: str


class Rival(NamedTuple):
    """One way to do a control step for a batch of replays.

    begin: () → state, predicted for the first command.
    advance: (state, z `[B, n_s]`) → state, command `[B, n_u]`, p(end) `[B]`; the step is update,
        end probability, prediction and command. It may change the state it is given.
    belief: state → the first replay's predicted p(I, τ), `[N, L]`.
    """

    begin: Callable[[], Any]
    advance: Callable[[Any, np.ndarray], tuple[Any, np.ndarray, np.ndarray]]
    belief: Callable[[Any], np.ndarray]


def make_work(jump, n, length, replays, steps, n_sensors=7, n_commands=5) -> Work:
    """Return records that are random walks, and observations along the first at its pace."""
    rng = np.random.default_rng(0)
    sensors = _exact(0.02 * rng.normal(size=(n, length, n_sensors)).cumsum(axis=1))
    commands = _exact(rng.normal(size=(n, length, n_commands)))
    along = sensors[0, np.minimum(np.arange(steps), length - 1)]
    noise = SIGMA * rng.normal(size=(steps, replays, n_sensors))
    return Work(sensors, commands, _exact(along[:, None] + noise), jump)


def first_prediction(work: Work) -> np.ndarray:
    """Return the belief `[N, L]` of equations 5 and 6 before the first command; both readings."""
    n, length, _ = work.sensors.shape
    belief = np.zeros((n, length))
    belief[:, :3] = np.array([THETA_TAU, 1 - 2 * THETA_TAU, THETA_TAU]) / n
    return belief


def reference_beliefs(work: Work):
    """Yield p(I, τ), command, p(end) and the tolerance of each step of the first replay.

    float32 may be off by 1e-5 + 1e-6 (m + t) in the posterior after t steps, m being the
    largest distance, in σ, between an observation and the sample nearest to it.
    """
    sensors, commands = list(work.sensors), list(work.commands)
    params = reference.Params(THETA_I, THETA_TAU, np.full(work.sensors.shape[-1], SIGMA))
    belief = reference.predict(sensors, params, reference.init(sensors), work.jump)
    furthest = 0.0
    for t, z in enumerate(work.observations[:, 0]):
        apart = np.linalg.norm((work.sensors - z) / SIGMA, axis=-1)
        furthest = max(furthest, apart.min())
        belief, _ = reference.update(sensors, params, belief, z)
        ended = reference.end_probability(sensors, belief)
        belief = reference.predict(sensors, params, belief, work.jump)
        tolerated = 1e-5 + 1e-6 * (furthest + t + 1)
        yield np.exp(belief), reference.command(commands, belief), ended, tolerated


def errors(rival: Rival, work: Work, truth: list) -> dict[str, float]:
    """Return the largest errors of a rival's first replay.

    The command's is a share of the commands' range; `share` is the posterior's as a share of the
    tolerance.
    """
    state, largest = rival.begin(), dict.fromkeys(("posterior", "command", "end", "share"), 0.0)
    for z, (belief, command, ended, tolerated) in zip(work.observations, truth, strict=True):
        state, got_command, got_ended = rival.advance(state, z)
        posterior = float(np.abs(rival.belief(state) - belief).max())
        now = {
            "posterior": posterior,
            "command": float(np.abs(got_command[0] - command).max() / np.ptp(work.commands)),
            "end": float(abs(got_ended[0] - ended)),
            "share": float(posterior / tolerated),
        }
        largest = {name: float(np.maximum(largest[name], now[name])) for name in now}  # or NaN
    return largest


def _exact(x: np.ndarray) -> np.ndarray:
    return x.astype(np.float32).astype(np.float64)
