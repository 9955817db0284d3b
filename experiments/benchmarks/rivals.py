"""Ours and its rivals for `filter_step.py`, each on all cores.

- **ours**: what the studies call, `jaxreplay.tracker.Tracker`, some replays each, a thread a core.
- **NumPy**: float64, a replay a thread, arrays over records and moments and SciPy's erfc once a
  sample and sensor. Plain probabilities, faster than logarithms: what falls below 1e-308 is
  lost, which at ordinary distances matters to no digit shown.
- **Numba**: see `numba_rival.py`; left out where Numba is not installed.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.special import erfc
from work import SIGMA, THETA_I, THETA_TAU, Rival, Work, first_prediction

from jaxreplay import Params, Records, build_filter
from jaxreplay.tracker import LANES, Tracker

try:
    import numba_rival
except ModuleNotFoundError as error:
    if error.name != "numba":
        raise
    numba_rival = None

ANYTHING = 1  # bits: to drop a hypothesis of any probability
CORES = os.cpu_count()
LAST_STEPS = 10
SHORT = 1e-5  # σ, below which a segment is the point Gaussian at its middle
_threads = ThreadPoolExecutor(CORES)


def records_of(work: Work) -> Records:
    """The work's records as ours."""
    return Records.from_sequences(list(work.sensors), list(work.commands))


def ours(work: Work, replays: int, window: int | None) -> Rival:
    """The filter as the studies run it, but in windows of one width, whatever they drop."""
    records = records_of(work)
    size = min(LANES, -(-replays // CORES))
    parts = [slice(i, min(i + size, replays)) for i in range(0, replays, size)]
    n_sensors = work.sensors.shape[-1]
    params = Params(
        np.full(size, THETA_I), np.full(size, THETA_TAU), np.full((size, n_sensors), SIGMA)
    )
    posterior = build_filter(work.jump, window).posterior

    def begin():
        trackers = []
        for _ in parts:
            tracker = Tracker(records, params, work.jump, () if window is None else (window,))
            tracker.droppable[:] = ANYTHING
            trackers.append(tracker)
        return trackers

    def advance_part(tracker, part, z):
        going = np.arange(size) < part.stop - part.start
        lanes = np.zeros((size, n_sensors))
        lanes[going] = z[part]
        _, ended = tracker.advance(lanes, going)
        return tracker.command[going], ended[going]

    def advance(trackers, z):
        done = _threads.map(advance_part, trackers, parts, [z] * len(parts))
        command, ended = zip(*done, strict=True)
        return trackers, np.concatenate(command), np.concatenate(ended)

    def belief(trackers):
        return np.asarray(posterior(records, trackers[0].belief(0)))

    return Rival(begin, advance, belief)


def numpy_rival(work: Work, replays: int) -> Rival:
    """The step in NumPy and SciPy, float64, for records of one length and all sensors seen."""
    n, _, n_sensors = work.sensors.shape
    zeta = np.ascontiguousarray(np.moveaxis(work.sensors, -1, 0))
    commands = np.ascontiguousarray(np.moveaxis(work.commands, -1, 0))
    length = np.abs(np.diff(zeta))
    short = [np.nonzero(of_sensor < SHORT * SIGMA) for of_sensor in length]
    with np.errstate(divide="ignore"):
        per_length = np.where(length < SHORT * SIGMA, 0, 1 / length)
    share = THETA_I / (n - 1)
    keep = 1 - THETA_I - share

    def multiply_likelihood(belief, z, x, tail, mean, negative, between):
        """Equation 2 up to a factor that all states share; arrays from x on are scratch."""
        for k in range(n_sensors):
            np.subtract(zeta[k], z[k], out=x)
            np.multiply(x, 1 / (SIGMA * np.sqrt(2)), out=x)
            np.less(x, 0, out=negative)
            np.not_equal(negative[:, 1:], negative[:, :-1], out=between)
            np.copysign(erfc(np.abs(x, out=tail), out=tail), x, out=tail)
            np.subtract(tail[:, 1:], tail[:, :-1], out=mean)
            np.abs(mean, out=mean)
            np.subtract(2, mean, out=mean, where=between)
            np.multiply(mean, per_length[k], out=mean)
            if len(short[k][0]):
                i, j = short[k]
                middle = (x[i, j] + x[i, j + 1]) / 2
                mean[i, j] = np.exp(-(middle**2)) * np.sqrt(2 / np.pi) / SIGMA
            np.add(mean[:, 1:], mean[:, :-1], out=tail[:, 1:-1])
            np.multiply(mean[:, [0, -1]], 2, out=tail[:, :: tail.shape[1] - 1])
            np.multiply(belief, tail, out=belief)

    def advance_one(state, z):
        belief, moved, *scratch = state
        multiply_likelihood(belief, z, *scratch)
        belief /= belief.sum()
        ended = belief[:, -LAST_STEPS:].sum()

        np.multiply(belief, THETA_TAU, out=moved)
        for step, taken in ((1, 1 - 2 * THETA_TAU), (2, THETA_TAU)):
            moved[:, step:] += np.multiply(belief, taken, out=scratch[0])[:, :-step]
        moved[:, -1] += (1 - THETA_TAU) * belief[:, -1] + THETA_TAU * belief[:, -2]
        if work.jump == "own_tau":
            weight = moved.sum(axis=1, keepdims=True)
            after = keep * weight + share * weight.sum()
            moved *= np.divide(after, weight, out=np.zeros_like(weight), where=weight > 0)
        else:
            everywhere = share * moved.sum(axis=0)
            moved *= keep
            moved += everywhere
        command = np.einsum("unl,nl->u", commands, moved)
        return (moved, belief, *scratch), command, ended

    def begin():
        scratch = [np.empty(zeta.shape[1:]) for _ in range(3)]
        scratch += [np.empty(length.shape[1:])]
        scratch += [np.empty(zeta.shape[1:], bool), np.empty(length.shape[1:], bool)]
        return [
            (first_prediction(work), *(np.empty_like(array) for array in scratch))
            for _ in range(replays)
        ]

    def advance(states, z):
        states, command, ended = zip(*_threads.map(advance_one, states, z), strict=True)
        return states, np.array(command), np.array(ended)

    return Rival(begin, advance, lambda states: states[0][0])


def numba_kernel(work: Work, replays: int) -> Rival:
    """The fused kernel of `numba_rival.py`."""
    n_sensors = work.sensors.shape[-1]
    nodes = np.pad(np.moveaxis(work.sensors, -1, 0), ((0, 0), (0, 0), (1, 1)), mode="reflect")
    lengths = np.diff(nodes).astype(np.float32)
    commands = np.ascontiguousarray(np.swapaxes(work.commands, 1, 2), np.float32)
    fixed = (work.jump == "own_tau", nodes.astype(np.float32), lengths, commands)
    params = (
        np.full(replays, THETA_I), np.full(replays, THETA_TAU), np.full((replays, n_sensors), SIGMA)
    )  # fmt: skip

    def begin():
        p = np.pad(first_prediction(work), ((0, 0), (2, 0)))
        mantissa, exponent = np.frexp(p)
        mantissa = np.where(p > 0, 2 * mantissa, 1)
        exponent = np.where(p > 0, exponent - 1, numba_rival.NOTHING)
        return [np.tile(x.astype(np.float32), (replays, 1, 1)) for x in (mantissa, exponent)]

    def advance(state, z):
        command = np.empty((replays, work.commands.shape[-1]), np.float32)
        ended = np.empty(replays, np.float32)
        numba_rival.advance(*fixed, *params, z[:replays], *state, command, ended)
        return state, command, ended

    def belief(state):
        return np.ldexp(state[0][0, :, 2:].astype(np.float64), state[1][0, :, 2:].astype(int))

    return Rival(begin, advance, belief)
