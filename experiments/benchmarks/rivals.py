"""Ours and its rivals for `filter_step.py`, each on all cores.

- **ours**: what the studies call, `jaxreplay.tracker.Tracker`, a process a core.
- **NumPy**: float64, a replay a thread, arrays over records and moments and SciPy's erfc once a
  sample and sensor. Plain probabilities, faster than logarithms: what falls below 1e-308 is
  lost, which at ordinary distances matters to no digit shown.
- **Numba**: see `numba_rival.py`; left out where Numba is not installed.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.connection import Connection

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
    """The filter as `jaxreplay run --workers` runs it, but in windows of one width.

    What they drop is not looked at. A process a core, each with its share of the replays.
    """
    size = -(-replays // CORES)
    parts = [slice(i, min(i + size, replays)) for i in range(0, replays, size)]
    context, ends = get_context("spawn"), []
    for core, part in enumerate(parts):
        mine, theirs = context.Pipe()
        share = (work._replace(observations=None), part.stop - part.start, window)
        context.Process(target=_serve, args=(theirs, core, *share), daemon=True).start()
        ends.append(mine)

    def ask(what, *shares):
        for end, *share in zip(ends, *shares, strict=True):
            end.send((what, *share))
        return [end.recv() for end in ends]

    def advance(state, z):
        command, ended = zip(*ask("advance", [z[part] for part in parts]), strict=True)
        return state, np.concatenate(command), np.concatenate(ended)

    return Rival(lambda: ask("begin"), advance, lambda state: ask("belief")[0])


def _serve(end: Connection, core: int, *share):
    """In a process of its own: begin, advance or tell the belief, as asked."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    run = Share(*share)
    while True:
        try:
            what, *given = end.recv()
        except EOFError:
            return
        end.send(getattr(run, what)(*given))


class Share:
    """What one process does of a batch."""

    def __init__(self, work: Work, replays: int, window: int | None):
        """The records and parameters."""
        self._records, self._replays, self._size = records_of(work), replays, min(LANES, replays)
        sigma = np.full((self._size, self._records.n_sensors), SIGMA)
        theta_i, theta_tau = np.full(self._size, THETA_I), np.full(self._size, THETA_TAU)
        self._params, self._jump = Params(theta_i, theta_tau, sigma), work.jump
        self._windows = () if window is None else (window,)
        self._posterior = build_filter(work.jump, window).posterior

    def begin(self):
        """Replays at their start."""
        self._trackers = [
            Tracker(self._records, self._params, self._jump, self._windows)
            for _ in range(0, self._replays, self._size)
        ]
        for tracker in self._trackers:
            tracker.droppable[:] = ANYTHING

    def advance(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Commands and p(end)."""
        n = len(self._trackers)
        lanes = np.zeros((n * self._size, self._records.n_sensors))
        lanes[: self._replays] = z
        going = np.arange(len(lanes)) < self._replays
        each = zip(self._trackers, np.split(lanes, n), np.split(going, n), strict=True)
        ended = np.concatenate([tracker.advance(*given)[1] for tracker, *given in each])
        command = np.concatenate([tracker.command for tracker in self._trackers])
        return command[: self._replays], ended[: self._replays]

    def belief(self) -> np.ndarray:
        """The first replay's, `[N, L]`."""
        return np.asarray(self._posterior(self._records, self._trackers[0].belief(0)))


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
