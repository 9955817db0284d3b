"""Gradient descent on the parameters, with a loss that scores left-out records.

The loss is the squared error of predicted commands, or minus the log evidence.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import chain, count
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxreplay.filter.belief import DEFAULT_JUMP, Jump
from jaxreplay.filter.steps import command, init, predict, update
from jaxreplay.loop.lanes import COMPILER_OPTIONS
from jaxreplay.machine import cores
from jaxreplay.params import Params
from jaxreplay.recordings.scores import command_scale, leave_out, sensor_span
from jaxreplay.records import Records

Score = Literal["commands", "evidence"]
SCORES: tuple[Score, ...] = ("commands", "evidence")
# Bounds that no step crosses.
PROBABILITY_BOUNDS = (1e-6, 0.999)  # of θ_I and of 2 θ_τ
SIGMA_BOUNDS = (1e-3, 10.0)  # of σ, as a share of the sensor's range
LEARNING_RATES = (0.2, 0.01)  # Adam's, at the first step and at the last
BATCH = 2  # left-out records whose gradients are summed for an optimisation step
WINDOW = 256  # samples of each record that a belief stores; the scores have no such limit


def optimise(
    records: Records,
    start: Params,
    jump: Jump = DEFAULT_JUMP,
    score: Score = "commands",
    steps: int = 30,
    seed: int = 0,
) -> Iterator[Params]:
    """Minimise a loss of left-out records along its gradient, with Adam.

    Each step follows the summed gradient of `BATCH` left-out records, in random order: all are left
    out once before any is left out again. The unknowns are logit θ_I, logit 2 θ_τ and log σ, within
    `PROBABILITY_BOUNDS` and `SIGMA_BOUNDS`. With two records θ_I remains as it is: leaving one out
    leaves one, from which there is no jump. Beliefs are stored in windows of `WINDOW` samples.

    Args:
        records: N ≥ 2 records.
        start: one set of parameters.
        jump: the reading of a jump, `"same_tau"` or `"own_tau"`.
        score: the loss: `"commands"`, the squared error of predicted commands, or `"evidence"`,
            minus the log evidence (see `scores`).
        steps: the number of optimisation steps.
        seed: of the order in which records are left out.

    Yields:
        `start`, clipped to the bounds, and the parameters after each step.

    Raises:
        ValueError: fewer than 2 records, or no command to predict.
    """
    scale = command_scale(records)
    if score == "commands" and not scale.any():
        raise ValueError("no command ever changes in the records: there is none to predict")
    others = [leave_out(records, i).centred() for i in range(records.n_records)]
    rows, weights = _rows(records), np.array([score == name for name in SCORES], float)
    span = sensor_span(records)
    bounds = zip(PROBABILITY_BOUNDS, SIGMA_BOUNDS, strict=True)
    low, high = (
        _unconstrained(Params(jnp.asarray(p), jnp.asarray(p / 2), jnp.asarray(share * span)))
        for p, share in bounds
    )
    x = optax.projections.projection_box(_unconstrained(start), low, high)
    first, last = LEARNING_RATES
    adam = optax.adam(optax.cosine_decay_schedule(first, steps, last / first))
    state = adam.init(x)
    rng = np.random.default_rng(seed)
    order = chain.from_iterable(rng.permutation(records.n_records).tolist() for _ in count())
    yield _params(x)

    def gradient(i: int) -> _Unconstrained:
        return _gradient(x, others[i], rows[i], scale, weights, jump)

    gradient(0)  # compiles; else each thread would compile the same program
    with ThreadPoolExecutor(cores()) as threads:
        for _ in range(steps):
            left_out = [next(order) for _ in range(min(BATCH, records.n_records))]
            slope = jax.tree.map(lambda *each: sum(each), *threads.map(gradient, left_out))
            step, state = adam.update(slope, state)
            x = optax.projections.projection_box(optax.apply_updates(x, step), low, high)
            yield _params(x)


def _rows(records: Records) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return each record's observations `[L, n_s]`, centred, and commands `[L, n_u]`.

    Rows past a record's end are NaN: they add no evidence and no error.
    """
    past = np.arange(records.longest) >= np.asarray(records.lengths)[:, None]
    both = np.asarray(records.nodes)[:, :, 1:-1], np.asarray(records.commands)
    observed, sent = (np.where(past, np.nan, x).transpose(1, 2, 0) for x in both)
    return list(zip(observed, sent, strict=True))


class _Unconstrained(NamedTuple):
    """Parameters as numbers that may take any value."""

    theta_i: jax.Array  # logit θ_I
    theta_tau: jax.Array  # logit 2 θ_τ
    sigma: jax.Array  # log σ


def _unconstrained(params: Params) -> _Unconstrained:
    logit = jax.scipy.special.logit
    return _Unconstrained(logit(params.theta_i), logit(2 * params.theta_tau), jnp.log(params.sigma))


def _params(x: _Unconstrained) -> Params:
    logistic = jax.nn.sigmoid
    return Params(logistic(x.theta_i), logistic(x.theta_tau) / 2, jnp.exp(x.sigma))


@partial(jax.jit, static_argnames="jump", compiler_options=COMPILER_OPTIONS)
def _gradient(
    x: _Unconstrained,
    records: Records,
    rows: tuple[jax.Array, jax.Array],
    scale: jax.Array,
    weights: jax.Array,
    jump: Jump,
) -> _Unconstrained:
    """Compute the gradient of a record's loss, given the other records, centred.

    loss = Σ_t w · (Σ_k (scale_k (u_k,t − v_k,t))², −log p(Z_t | Z_1:t−1))

    The weights w choose the loss at run time, so one compiled program serves both. To save memory
    the forward pass stores only the belief of each step, and the backward pass computes the rest
    of the step again.
    """

    def loss(x: _Unconstrained) -> jax.Array:
        params = _params(x)

        @jax.checkpoint
        def step(belief, row):
            z, v = row
            belief = predict(records, params, belief)
            error = jnp.where(jnp.isnan(v), 0.0, scale * (command(records, belief) - v))
            belief, log_evidence = update(records, params, belief, z)
            return belief, jnp.stack([jnp.sum(error**2), -log_evidence]) @ weights

        return jnp.sum(jax.lax.scan(step, init(records, jump, WINDOW), rows)[1])

    return jax.grad(loss)(x)
