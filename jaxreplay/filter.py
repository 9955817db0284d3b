"""The Bayesian filter over records and moments (§ 2.2 and 2.3).

The order of a control step is predict, command, act, observe, update (§ 2.3), so that time
alone can trigger a command. All functions are pure, and jitted in what :func:`build_filter`
gives; they take one replay and are meant to be `jax.vmap`-ped over params, belief and z, with the
records shared.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxreplay.observation import anchor_point, likelihood, log_density
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.scaled import Scaled, scaled
from jaxreplay.transition import predict_own_tau, predict_same_tau
from jaxreplay.window import NOTHING, follow, resize, view

PREDICTIONS = {"same_tau": predict_same_tau, "own_tau": predict_own_tau}
LAST_STEPS = 10  # § 2.2.5


class Belief(NamedTuple):
    """p(I_t, τ_t | Z) of one replay, over the W moments of each record that are held.

    Attributes:
        p: `[N, W]` probabilities, zero past a record's end; each with an exponent of its own
            (see :mod:`jaxreplay.scaled`), so that no hypothesis is ever lost to underflow.
        start: the first moment held, int32; one for all records under `same_tau`, where a jump
            keeps τ, `[N]` under `own_tau`. 0 without a window.
        dropped: log2 of the likeliest hypothesis yet dropped at the window's edges, rounded
            down, int32; of its probability within its record under `own_tau`. Very negative if
            there was none.
    """

    p: Scaled
    start: jax.Array
    dropped: jax.Array


class Filter(NamedTuple):
    """The functions :func:`build_filter` gives; each is described under its own name below."""

    init: Callable[[Records], Belief]
    predict: Callable[[Records, Params, Belief], Belief]
    command: Callable[[Records, Belief], jax.Array]
    update: Callable[[Records, Params, Belief, jax.Array], tuple[Belief, jax.Array]]
    posterior: Callable[[Records, Belief], jax.Array]
    end_probability: Callable[[Records, Belief], jax.Array]


@cache
def build_filter(jump: str = "same_tau", window: int | None = None) -> Filter:
    """The filter for one reading of a jump.

    Args:
        jump: `"same_tau"`, equation 6 as printed, or `"own_tau"`, each record keeping its own
            conditional over τ (see :mod:`jaxreplay.transition`).
        window: how many moments of each record to hold, in a window that travels with the
            belief; None holds them all. See :mod:`jaxreplay.window`, and watch
            `Belief.dropped`.

    Raises:
        ValueError: another reading, or a window too narrow to move.
    """
    if jump not in PREDICTIONS:
        raise ValueError(f"jump must be one of {', '.join(PREDICTIONS)}; got {jump!r}")
    if window is not None and window < 32:
        raise ValueError(f"window must be None or at least 32 moments; got {window}")
    functions = (
        partial(init, jump=jump, window=window),
        partial(predict, jump=jump),
        command,
        update,
        posterior,
        end_probability,
    )
    filter = Filter(*(jax.jit(function) for function in functions))

    def update_raw(records: Records, params: Params, belief: Belief, z: jax.Array):
        return filter.update(records, params, belief, records.centre(z))

    return filter._replace(update=update_raw)


def init(records: Records, jump: str = "same_tau", window: int | None = None) -> Belief:
    """Equation 5: every record alike, at its first sample, before the first prediction."""
    held = min(window or records.longest, records.longest)
    p = jnp.zeros((records.n_records, held), records.nodes.dtype)
    return Belief(
        p=scaled(p.at[:, 0].set(1 / records.n_records)),
        start=jnp.zeros(() if jump == "same_tau" else records.n_records, jnp.int32),
        dropped=jnp.asarray(NOTHING, jnp.int32),
    )


def predict(records: Records, params: Params, belief: Belief, jump: str = "same_tau") -> Belief:
    """Equation 6, in one of its readings (see :mod:`jaxreplay.transition`)."""
    belief = follow(records, belief)
    p = PREDICTIONS[jump](view(records, belief), params, belief.p)
    return belief._replace(p=p)


def command(records: Records, belief: Belief) -> jax.Array:
    """Equation 8: the expectation `[n_u]` of the recorded commands under the belief."""
    commands = view(records, belief).commands
    return jnp.einsum("kij,ij->k", commands, belief.p.value(), precision="highest")


def update(
    records: Records, params: Params, belief: Belief, z: jax.Array
) -> tuple[Belief, jax.Array]:
    """Equation 9: take in the observation made after the command.

    Args:
        records: N records of n_s sensors.
        params: σ is used here, θ_I and θ_τ are not.
        belief: the predicted belief, p(I_t, τ_t | Z_{1:t−1}).
        z: `[n_s]` Z_t; NaN for a sensor that gave nothing. Less the records' offset: a
            :class:`Filter` subtracts it first (see `Records.centre`).

    Returns:
        The belief p(I_t, τ_t | Z_{1:t}), and log p(Z_t | Z_{1:t−1}), the log evidence.

    Raises:
        ValueError: z or σ does not have n_s values.
    """
    z = jnp.asarray(z, records.nodes.dtype)
    sigma = jnp.asarray(params.sigma, records.nodes.dtype)
    for name, value in (("z", z), ("sigma", sigma)):
        if value.shape != (records.n_sensors,):
            raise records.misfit(name, value.shape)
    held = view(records, belief)
    anchor = jax.lax.stop_gradient(anchor_point(held, sigma, z, belief.p))
    joint = belief.p * likelihood(held, sigma, z, anchor)
    evidence = joint.sum()
    log_evidence = evidence.log() + log_density(z, anchor, sigma)
    return belief._replace(p=joint / evidence), log_evidence


def posterior(records: Records, belief: Belief) -> jax.Array:
    """The belief as probabilities `[N, L]`, zero past a record's end."""
    return resize(records, belief, None).p.value()


def end_probability(records: Records, belief: Belief) -> jax.Array:
    """§ 2.2.5: p(τ in the last 10 samples of its record); above 0.9 the task is completed.

    A record shorter than that counts whole.
    """
    held = view(records, belief)
    near_end = jnp.arange(held.longest) >= held.lengths[:, None] - LAST_STEPS
    return jnp.sum(jnp.where(near_end, belief.p.value(), 0.0))
