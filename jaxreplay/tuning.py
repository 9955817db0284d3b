"""Parameters from the records alone: leave one demonstration out, filter it with the others.

A set of parameters is good if the others foresee what the one left out was told to do (the error
of the predicted command), and what it observed (its log evidence). Evidence is the filter's own
measure, but has no maximum where a sensor repeats values exactly: there a density grows without end
as σ goes to 0, whatever becomes of the commands.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import chain, count
from threading import Lock
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxreplay.filter import command, init, predict, update
from jaxreplay.machine import cores
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.tracker import COMPILER_OPTIONS, Tracker

SCORES = ("commands", "evidence")
# Where the climb ends at the latest.
PROBABILITIES = (1e-6, 0.999)  # θ_I and 2 θ_τ
SHARES = (1e-3, 10.0)  # σ, of the sensor's range
RATES = (0.2, 0.01)  # of Adam, at the first step and at the last
TOGETHER = 2  # held-out records whose gradients make a step
WINDOW = 256  # moments of each record held on the climb; scores are without this limit


class Scores(NamedTuple):
    """How well P sets of parameters explain H held-out records.

    Attributes:
        log_evidence: `[P]` log p(Z_1:T) of all, per time step.
        command_error: `[P]` root mean square over all time steps and commands of the predicted
            command less the recorded one, as a share of the command's range in the records. A
            command that never changes is left out.
        log_evidence_each: `[P, H]` the same of each held-out record.
        command_error_each: `[P, H]`.
        steps: `[H]` the held-out records' lengths.
    """

    log_evidence: np.ndarray
    command_error: np.ndarray
    log_evidence_each: np.ndarray
    command_error_each: np.ndarray
    steps: np.ndarray


def leave_out(records: Records, i: int) -> Records:
    """The records without one, in the same shape whichever it is, so that programs are shared.

    Their offset and their padding stay those of all records.

    Raises:
        ValueError: i is none of them, or nothing would be left.
    """
    if records.n_records < 2:
        raise ValueError("one record cannot be left out: there is only 1; at least 2 are needed")
    if not 0 <= i < records.n_records:
        raise ValueError(f"no record {i}: there are {records.n_records}, counted from 0")
    return records.subset(k for k in range(records.n_records) if k != i)


def leave_one_out(
    records: Records,
    params: Params,
    jump: str = "same_tau",
    held_out: Sequence[int] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Scores:
    """Filter each held-out record's observations with the others, for many parameters at once.

    Row t of a record is a command and the observation made after it: what is compared with the
    recorded command is the one predicted (equation 8) before that row's observation is known.

    Args:
        records: N ≥ 2 records.
        params: `[P]`-batched parameters, a whole grid of them if need be.
        jump: `"same_tau"` or `"own_tau"`.
        held_out: the records to hold out, one at a time; all if None.
        progress: called with the time steps done and their total, one call at a time.

    Raises:
        ValueError: fewer than 2 records, or no such record.
    """
    chosen = range(records.n_records) if held_out is None else held_out
    parts = [leave_out(records, i) for i in chosen]
    sensors, commands = records.sequences()
    scale = _command_scale(records)
    steps = np.array([len(sensors[i]) for i in chosen])
    done, lock = np.zeros(len(steps), int), Lock()
    n = len(params.theta_i)

    def filtered(h: int) -> tuple[np.ndarray, np.ndarray]:
        tracker = Tracker(parts[h], params, jump)
        everyone, evidence, square = np.ones(n, bool), np.zeros(n), np.zeros(n)
        for z, v in zip(sensors[chosen[h]], commands[chosen[h]], strict=True):
            square += np.sum((scale * (tracker.command - v)) ** 2, axis=1)
            evidence += tracker.advance(np.broadcast_to(z, (n, len(z))), everyone)[0]
            with lock:
                done[h] += 1
                progress(int(done.sum()), int(steps.sum()))
        return evidence, square

    with ThreadPoolExecutor(cores()) as threads:  # one for each core: a step keeps one busy
        evidence, square = np.array(list(threads.map(filtered, range(len(steps))))).swapaxes(0, 1)
    return Scores(
        log_evidence=evidence.sum(axis=0) / steps.sum(),
        command_error=np.sqrt(square.sum(axis=0) / steps.sum()),
        log_evidence_each=(evidence / steps[:, None]).T,
        command_error_each=np.sqrt(square / steps[:, None]).T,
        steps=steps,
    )


def sensor_span(records: Records) -> np.ndarray:
    """`[n_s]` the range of each sensor in the records, in its unit; 1 for one that never moves."""
    low, high = np.asarray(records.span, float)
    return np.where(high == low, 1.0, high - low)


def usual(records: Records) -> Params:
    """What to start from: θ_I 0.1, θ_τ 0.05, each σ a tenth of the sensor's range."""
    return Params(0.1, 0.05, 0.1 * sensor_span(records))


def climb(
    records: Records,
    start: Params,
    jump: str = "same_tau",
    score: str = "commands",
    steps: int = 30,
    seed: int = 0,
) -> Iterator[Params]:
    """Better a score of held-out records by its gradient, with Adam.

    A step follows the summed gradient of `TOGETHER` held-out records; all have their turn before
    one has its second. Beliefs are held in windows of `WINDOW` moments. Steps are in the logits
    of θ_I and of 2 θ_τ and in log σ, and stay within `PROBABILITIES` and `SHARES`.

    Args:
        records: N ≥ 2 records.
        start: one set of parameters.
        jump: `"same_tau"` or `"own_tau"`.
        score: `"commands"`, the squared error of predicted commands, or `"evidence"`.
        steps: how many.
        seed: of the order in which records are held out.

    Yields:
        The parameters at the start, and after each step.

    Raises:
        ValueError: fewer than 2 records, or no command to predict.
    """
    scale = _command_scale(records)
    if score == "commands" and not scale.any():
        raise ValueError("no command ever changes in the records: there is none to predict")
    parts = [leave_out(records, i) for i in range(records.n_records)]
    rows, weights = _rows(records), np.array([score == name for name in SCORES], float)
    span = sensor_span(records)
    bounds = zip(PROBABILITIES, SHARES, strict=True)
    low, high = (_free(Params(p, p / 2, share * span)) for p, share in bounds)
    free = optax.projections.projection_box(_free(start), low, high)
    first, last = RATES
    adam = optax.adam(optax.cosine_decay_schedule(first, steps, last / first))
    state = adam.init(free)
    rng = np.random.default_rng(seed)
    turns = chain.from_iterable(rng.permutation(records.n_records).tolist() for _ in count())
    yield _params(free)

    def gradient(i: int) -> _Free:
        return _gradient(free, parts[i], rows[i], scale, weights, jump)

    gradient(0)  # compiled once, before the threads, each of which would do it
    with ThreadPoolExecutor(cores()) as threads:
        for _ in range(steps):
            held_out = [next(turns) for _ in range(min(TOGETHER, records.n_records))]
            slope = jax.tree.map(lambda *each: sum(each), *threads.map(gradient, held_out))
            step, state = adam.update(slope, state)
            free = optax.projections.projection_box(optax.apply_updates(free, step), low, high)
            yield _params(free)


def _command_scale(records: Records) -> np.ndarray:
    """`[n_u]` what a command's error is multiplied by, for the squares' sum to be the mean."""
    span = np.ptp(np.concatenate(records.sequences()[1]), axis=0)
    changes = span > 0
    scale = changes / np.where(changes, span, 1.0) / np.sqrt(max(changes.sum(), 1))
    return scale.astype(records.commands.dtype)


def _rows(records: Records) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each record, observations `[L, n_s]`, centred, and commands `[L, n_u]`; NaN past its end.

    Such rows have no evidence and no error.
    """
    past = np.arange(records.longest) >= np.asarray(records.lengths)[:, None]
    both = np.asarray(records.nodes)[:, :, 1:-1], np.asarray(records.commands)
    seen, sent = (np.where(past, np.nan, x).transpose(1, 2, 0) for x in both)
    return list(zip(seen, sent, strict=True))


class _Free(NamedTuple):
    """Parameters as numbers that may take any value."""

    theta_i: jax.Array  # logit θ_I
    theta_tau: jax.Array  # logit 2 θ_τ
    sigma: jax.Array  # log σ


def _free(params: Params) -> _Free:
    logit = jax.scipy.special.logit
    return _Free(logit(params.theta_i), logit(2 * params.theta_tau), jnp.log(params.sigma))


def _params(free: _Free) -> Params:
    logistic = jax.nn.sigmoid
    return Params(logistic(free.theta_i), logistic(free.theta_tau) / 2, jnp.exp(free.sigma))


@partial(jax.jit, static_argnames="jump", compiler_options=COMPILER_OPTIONS)
def _gradient(free: _Free, records: Records, rows, scale, weights, jump: str) -> _Free:
    """Of what scores sum up, weighted; so one program serves all of them.

    Only beliefs are kept for the way back; the rest is computed once more.
    """

    def loss(free: _Free):
        params = _params(free)

        @jax.checkpoint
        def step(belief, row):
            z, v = row
            belief = predict(records, params, belief, jump)
            error = jnp.where(jnp.isnan(v), 0.0, scale * (command(records, belief) - v))
            belief, log_evidence = update(records, params, belief, z)
            return belief, jnp.stack([jnp.sum(error**2), -log_evidence]) @ weights

        return jnp.sum(jax.lax.scan(step, init(records, jump, WINDOW), rows)[1])

    return jax.grad(loss)(free)
