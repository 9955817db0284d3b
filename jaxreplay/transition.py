"""The transition model (§ 2.2.3) and the prediction it makes (§ 2.3.1)."""

import jax
import jax.numpy as jnp

from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.scaled import Scaled, scaled, select, weighted
from jaxreplay.stage import stage


@stage
def record_transition(theta_i: jax.Array, mass: Scaled) -> Scaled:
    """Equation 3: stay in the record with 1 − θ_I, else jump to any of the others alike.

    With N = 1 there is nowhere to jump: the identity (the paper leaves it open).

    Args:
        theta_i: θ_I.
        mass: `[N, …]` the mass in each record.

    Returns:
        `[N, …]` the mass after the jump.
    """
    n = mass.exponent.shape[0]
    if n == 1:
        return mass
    return weighted((scaled(1 - theta_i), mass), (scaled(theta_i / (n - 1)), _sum_of_others(mass)))


@stage
def time_transition(lengths: jax.Array, theta_tau: jax.Array, mass: Scaled) -> Scaled:
    """Equation 4: a 3-tap convolution along τ, with (θ_τ, 1 − 2θ_τ, θ_τ) for +0, +1, +2.

    The last sample of a record absorbs what would pass it (decided; the paper is silent).

    Args:
        lengths: `[N]` of the records.
        theta_tau: θ_τ.
        mass: `[N, L]` the mass at each moment.

    Returns:
        `[N, L]` the mass after the step.
    """
    last = jnp.arange(mass.exponent.shape[1]) == lengths[:, None] - 1
    before = mass.padded((2, 0))
    stay = select(last, scaled(jnp.ones_like(theta_tau)), scaled(theta_tau))
    step = select(last, scaled(1 - theta_tau), scaled(1 - 2 * theta_tau))
    moved = weighted((stay, mass), (step, before[:, 1:-1]), (scaled(theta_tau), before[:, :-2]))
    return moved.where(_inside(lengths, mass))


def predict_same_tau(records: Records, params: Params, belief: Scaled) -> Scaled:
    """Equation 6 as printed: a jump keeps τ, the moment of the record it leaves.

    The step along τ is taken in the record that is left, then comes the jump. Mass that lands
    past the end of the record it jumps to is dropped and the rest renormalised once; if
    nothing remains (θ_I = 1 into ended records), the belief before the step is kept.
    """
    moved = time_transition(records.lengths, params.theta_tau, belief)
    landed = record_transition(params.theta_i, moved).where(_inside(records.lengths, belief))
    remaining = landed.sum()
    return select(remaining.mantissa > 0, landed / remaining, belief)


def predict_own_tau(records: Records, params: Params, belief: Scaled) -> Scaled:
    """Equation 6, each record keeping its own conditional over τ: a jump lands where it stands.

    p(I_t = i, τ_t) = [Σ_i' p(I_t = i | i') p(I_{t−1} = i')] [Σ_τ' p(τ_t | τ') p(τ' | i)], the
    reading of the authors' later code. It is not the exact filter of equation 1: the evidence
    under it is that of this approximation, and a record's τ may fall behind another's, which
    equation 4 forbids.
    """
    weight = belief.sum(axis=1)[:, None]
    conditional = time_transition(records.lengths, params.theta_tau, belief / weight)
    return record_transition(params.theta_i, weight) * conditional


def _inside(lengths: jax.Array, mass: Scaled) -> jax.Array:
    """Which of `[N, L]` are moments of a record, not padding."""
    return jnp.arange(mass.exponent.shape[1]) < lengths[:, None]


def _sum_of_others(mass: Scaled) -> Scaled:
    """Σ_{i' ≠ i} mass[i'] for every i along axis 0, without cancellation.

    The sum less the term itself is exact enough where a term as large remains in it; a term that
    is larger than all others needs their sum. Not normalised.
    """
    highest = jnp.max(mass.exponent, axis=0)
    top = mass.exponent == highest
    tops = jnp.sum(jnp.where(top, mass.mantissa, 0.0), axis=0)
    rest = mass.where(~top)
    second = jnp.max(rest.exponent, axis=0)
    rests = jnp.sum(rest.at(second), axis=0)
    alone = top & (tops == mass.mantissa)
    apart = jnp.where(top, mass.mantissa, rest.at(highest))
    others = (tops - apart) + Scaled(rests, second).at(highest)
    return Scaled(jnp.where(alone, rests, others), jnp.where(alone, second, highest))
