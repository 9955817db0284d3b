"""Ours and its rivals for `filter_step.py`, each on all cores.

- **ours**: what the studies call, `jaxreplay.loop.tracker.Tracker`, a process a core.
- **NumPy**: see `numpy_rival.py`; a replay a thread.
- **Numba**: see `numba_rival.py`; left out where Numba is not installed.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.connection import Connection

import numpy as np
import numpy_rival
from work import SIGMA, THETA_I, THETA_TAU, Rival, Work, first_prediction

from jaxreplay import Params, Records, build_filter, reference
from jaxreplay.filter.options import Options
from jaxreplay.loop.tracker import LANES, Tracker

try:
    import numba_rival
except ModuleNotFoundError as error:
    if error.name != "numba":
        raise
    numba_rival = None

ANYTHING = 1  # bits: to drop a hypothesis of any probability
CORES = os.cpu_count()
_threads = ThreadPoolExecutor(CORES)


def records_of(work: Work) -> Records:
    """Return the work's records as `Records`."""
    return Records.from_sequences(list(work.sensors), list(work.commands))


def ours(work: Work, replays: int, window: int | None) -> Rival:
    """Return the filter as `jaxreplay run --workers` runs it, but in windows of one width.

    They may drop any hypothesis. A process a core, each with its share of the replays.
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
    """Run in a process of its own: call methods of :class:`Share` as they are asked for."""
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
    """The part of a batch that one process does."""

    def __init__(self, work: Work, replays: int, window: int | None):
        """Store records and parameters."""
        self._records, self._replays, self._size = records_of(work), replays, min(LANES, replays)
        sigma = np.full((self._size, self._records.n_sensors), SIGMA)
        theta_i, theta_tau = np.full(self._size, THETA_I), np.full(self._size, THETA_TAU)
        self._params, self._options = Params(theta_i, theta_tau, sigma), Options(work.jump)
        self._windows = () if window is None else (window,)
        self._posterior = build_filter(work.jump, window).posterior

    def begin(self):
        """Begin all replays."""
        self._trackers = [
            Tracker(self._records, self._params, self._options, self._windows)
            for _ in range(0, self._replays, self._size)
        ]
        for tracker in self._trackers:
            tracker.droppable[:] = ANYTHING

    def advance(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return commands `[B, n_u]` and p(end) `[B]` after an observation z `[B, n_s]`."""
        n = len(self._trackers)
        lanes = np.zeros((n * self._size, self._records.n_sensors))
        lanes[: self._replays] = z
        going = np.arange(len(lanes)) < self._replays
        each = zip(self._trackers, np.split(lanes, n), np.split(going, n), strict=True)
        ended = np.concatenate([tracker.observe(*given)[1] for tracker, *given in each])
        command = np.concatenate([tracker.command for tracker in self._trackers])
        return command[: self._replays], ended[: self._replays]

    def belief(self) -> np.ndarray:
        """Return the first replay's belief, `[N, L]`."""
        return np.asarray(self._posterior(self._records, self._trackers[0].belief(0)))


def numpy_step(work: Work, replays: int) -> Rival:
    """Return a step that calls the functions of `numpy_rival.py` one after the other."""
    params = reference.Params(THETA_I, THETA_TAU, np.full(work.sensors.shape[-1], SIGMA))
    records = numpy_rival.records_of(work.sensors, work.commands, params)

    def one(state, z):
        belief, spare, memory = state
        belief, _ = numpy_rival.update(records, params, belief, z, spare, memory)
        ended = numpy_rival.end_probability(belief)
        predicted = numpy_rival.predict(params, belief, work.jump, spare, memory)
        return (predicted, belief, memory), numpy_rival.command(records, predicted), ended

    def begin():
        first = first_prediction(work)
        return [
            (first.copy(), np.empty_like(first), numpy_rival.memory_for(records))
            for _ in range(replays)
        ]

    def advance(states, z):
        states, command, ended = zip(*_threads.map(one, states, z), strict=True)
        return states, np.array(command), np.array(ended)

    return Rival(begin, advance, lambda states: states[0][0])


def numba_step(work: Work, replays: int) -> Rival:
    """Return the fused kernel of `numba_rival.py`."""
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
        numba_rival.advance(*fixed, *params, *state, z[:replays], command, ended)
        return state, command, ended

    def belief(state):
        return np.ldexp(state[0][0, :, 2:].astype(np.float64), state[1][0, :, 2:].astype(int))

    return Rival(begin, advance, belief)
