"""The steps of the filter (§ 2.2.4 to 2.3.3): predict, command, act, observe, update.

Commands come before observations, so that time alone can trigger one (§ 2.3). All functions are
pure and take one replay; `jax.vmap` runs them over params, beliefs and observations.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter.belief import DEFAULT_JUMP, NOTHING_DROPPED, Belief, Jump
from jaxreplay.filter.numerics.anchor import anchor_point
from jaxreplay.filter.numerics.scaled import exp, scaled
from jaxreplay.filter.observation import likelihood, log_density
from jaxreplay.filter.options import LAST_STEPS, Start
from jaxreplay.filter.transition import predict_own_tau, predict_same_tau
from jaxreplay.filter.window import follow, resize, view
from jaxreplay.params import Params
from jaxreplay.records import Records

_PREDICTIONS = {"same_tau": predict_same_tau, "own_tau": predict_own_tau}


def init(
    records: Records,
    jump: Jump = DEFAULT_JUMP,
    window: int | None = None,
    start: Start = "first",
) -> Belief:
    """Return the belief of equation 5: p = 1/N at each record's first sample, else 0.

    A robot that may be anywhere starts with p = 1 / (N L_i) at each sample of record i instead.

    Args:
        records: N records.
        jump: the reading of a jump, `"same_tau"` or `"own_tau"`.
        window: samples of each record to store; None stores all.
        start: `"first"` (equation 5) or `"anywhere"`.

    Raises:
        ValueError: a start anywhere is to be stored in a window.
    """
    if window is not None and window >= records.longest:
        window = None
    if start == "anywhere" and window is not None:
        raise ValueError(f"a start anywhere needs window=None, all samples; got {window}")
    column = jnp.arange(window or records.longest)[None]
    samples = records.lengths if start == "anywhere" else jnp.ones_like(records.lengths)
    share = 1 / (records.n_records * samples[:, None].astype(records.nodes.dtype))
    p = jnp.where(column < samples[:, None], share, 0.0)
    return Belief(
        p=scaled(p),
        start=jnp.zeros(() if jump == "same_tau" else records.n_records, jnp.int32),
        dropped=jnp.asarray(NOTHING_DROPPED, jnp.int32),
        jump=jump,
        window=window,
    )


def predict(records: Records, params: Params, belief: Belief) -> Belief:
    """Compute equation 6, in the belief's reading of a jump (see `transition`).

    Args:
        records: N records.
        params: θ_I and θ_τ are used.
        belief: p(I_{t−1}, τ_{t−1} | Z_{1:t−1}).

    Returns:
        p(I_t, τ_t | Z_{1:t−1}).
    """
    belief = follow(records, belief)
    p = _PREDICTIONS[belief.jump](view(records, belief), params, belief.p)
    return dataclasses.replace(belief, p=p)


def command(records: Records, belief: Belief) -> jax.Array:
    """Compute equation 8 (with 7): the expected command Σ_{i,j} v_j^i p(i, j).

    Args:
        records: N records.
        belief: the predicted belief, p(I_t, τ_t | Z_{1:t−1}).

    Returns:
        `[n_u]` in the actuators' units.
    """
    commands = view(records, belief).commands
    return jnp.einsum("kij,ij->k", commands, belief.p.value(), precision="highest")


def update(
    records: Records, params: Params, belief: Belief, z: jax.Array | np.ndarray
) -> tuple[Belief, jax.Array]:
    """Compute equation 9: p(I, τ | Z_{1:t}) ∝ p(Z_t | I, τ) p(I, τ | Z_{1:t−1}).

    Args:
        records: N records of n_s sensors.
        params: σ is used.
        belief: the predicted belief, p(I_t, τ_t | Z_{1:t−1}).
        z: `[n_s]` the observation Z_t, made after the command, in the sensors' units; NaN marks a
            missing sensor. The offset of the records is subtracted from it, in float64 if z is a
            NumPy array. (Records made by `Records.centred` have no offset left: for them z is
            already centred.)

    Returns:
        The belief p(I_t, τ_t | Z_{1:t}), and the log evidence log p(Z_t | Z_{1:t−1}).

    Raises:
        ValueError: z or σ does not have n_s values.
    """
    records.check_one_each(z=z, sigma=params.sigma)
    z = jnp.asarray(records.centre(z), records.nodes.dtype)
    params = jax.tree.map(lambda value: jnp.asarray(value, z.dtype), params)
    stored = view(records, belief)
    anchor = jax.lax.stop_gradient(anchor_point(stored, params, belief.p, z))
    joint = belief.p * exp(likelihood(stored, params, z, anchor))
    evidence = joint.sum()
    log_evidence = evidence.log() + log_density(params, z, anchor)
    return dataclasses.replace(belief, p=joint / evidence), log_evidence


def posterior(records: Records, belief: Belief) -> jax.Array:
    """Return the belief as probabilities `[N, L]`, 0 past a record's end and outside its window."""
    return resize(records, belief, None).p.value()


def end_probability(
    records: Records, belief: Belief, last_steps: int | jax.Array = LAST_STEPS
) -> jax.Array:
    """Return p(τ in the last 10 time steps) of § 2.2.5; above 0.9 the task is complete.

    The last samples of each record count, 10 or as many as given; a shorter record counts whole.
    """
    stored = view(records, belief)
    near_end = jnp.arange(stored.longest)[None] >= stored.lengths[:, None] - last_steps
    return jnp.sum(jnp.where(near_end, belief.p.value(), 0.0))
