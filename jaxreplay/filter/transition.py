"""The transition model (§ 2.2.3) and the predictions made with it (§ 2.3.1)."""

import jax
import jax.numpy as jnp

from jaxreplay.filter.numerics.scaled import Scaled, scaled, select, weighted
from jaxreplay.filter.numerics.stage import stage
from jaxreplay.params import Params
from jaxreplay.records import Records


def record_transition(params: Params, mass: Scaled) -> Scaled:
    """Apply equation 3, p(I_t | I_{t−1}), to the mass in each record.

        p(I_t = i | I_{t−1} = i') = 1 − θ_I if i = i', else θ_I / (N − 1)

    With N = 1 there is no other record to jump to: the identity (the paper leaves it open).

    Args:
        params: θ_I is used.
        mass: `[N, …]` probability before the jump.

    Returns:
        `[N, …]` probability after it.
    """
    return _jump(params.theta_i, mass)


def time_transition(records: Records, params: Params, mass: Scaled) -> Scaled:
    """Apply equation 4, p(τ_t | τ_{t−1}), within each record: a 3-tap convolution along τ.

        p(+0) = θ_τ, p(+1) = 1 − 2 θ_τ, p(+2) = θ_τ

    The last sample of a record absorbs what would pass it (the paper leaves it open).

    Args:
        records: their lengths are used.
        params: θ_τ is used.
        mass: `[N, L]` probability before the step.

    Returns:
        `[N, L]` probability after it.
    """
    return _step(records.lengths, params.theta_tau, mass)


def predict_same_tau(records: Records, params: Params, mass: Scaled) -> Scaled:
    """Compute equation 6 as printed: a jump keeps τ, and lands at that index of the new record.

        p(I_t, τ_t | Z_{1:t−1}) = Σ_I' p(I_t | I') Σ_τ' p(τ_t | τ') p(I', τ' | Z_{1:t−1})

    Probability that lands past the end of its new record is discarded, and the rest renormalised;
    if nothing remains (θ_I = 1, and all probability is past the end of every other record), the
    belief before the step is kept.

    Args:
        records: their lengths are used.
        params: θ_I and θ_τ are used.
        mass: `[N, L]` the belief before the step.

    Returns:
        `[N, L]` the predicted belief; it sums to 1.
    """
    moved = time_transition(records, params, mass)
    landed = record_transition(params, moved).where(_inside(records.lengths, mass))
    remaining = landed.sum()
    return select(remaining.mantissa > 0, landed / remaining, mass)


def predict_own_tau(records: Records, params: Params, mass: Scaled) -> Scaled:
    """Compute equation 6 with a distribution over τ that each record keeps for itself.

        p(I_t = i, τ_t) = [Σ_I' p(I_t = i | I') p(I')] · [Σ_τ' p(τ_t | τ') p(τ' | I_{t−1} = i)]

    A jump lands where the new record's own distribution over τ is: the reading of the authors'
    later software. It approximates equation 1. Its evidence is that of the approximation, and τ may
    decrease across a jump, which equation 4 forbids.

    Args:
        records: their lengths are used.
        params: θ_I and θ_τ are used.
        mass: `[N, L]` the belief before the step.

    Returns:
        `[N, L]` the predicted belief; its sum is that of `mass`.
    """
    weight = mass.sum(axis=1)[:, None]
    change = record_transition(params, weight) / weight
    return time_transition(records, params, mass * change)


def _jump(theta_i: jax.Array, mass: Scaled) -> Scaled:
    n = mass.exponent.shape[0]
    if n == 1:
        return mass
    return weighted((scaled(1 - theta_i), mass), (scaled(theta_i / (n - 1)), _sum_of_others(mass)))


@stage
def _step(lengths: jax.Array, theta_tau: jax.Array, mass: Scaled) -> Scaled:
    last = jnp.arange(mass.exponent.shape[1])[None] == lengths[:, None] - 1
    before = mass.padded((2, 0))
    stay = select(last, scaled(jnp.ones_like(theta_tau)), scaled(theta_tau))
    step = select(last, scaled(1 - theta_tau), scaled(1 - 2 * theta_tau))
    moved = weighted((stay, mass), (step, before[:, 1:-1]), (scaled(theta_tau), before[:, :-2]))
    return moved.where(_inside(lengths, mass))


def _inside(lengths: jax.Array, mass: Scaled) -> jax.Array:
    """Mark the `[N, L]` entries that are samples of a record, not padding."""
    return jnp.arange(mass.exponent.shape[1])[None] < lengths[:, None]


def _sum_of_others(mass: Scaled) -> Scaled:
    """Return Σ_{i' ≠ i} mass[i'] for every i along axis 0, without cancellation.

    The total minus the term is accurate, unless this term is more than half of the total; then the
    others are summed by themselves.
    """
    total = mass.sum(axis=0)[None]
    term = mass.at(total.exponent)
    largest = term > total.mantissa / 2
    others = mass.where(~largest).sum(axis=0)[None]
    return select(largest, others, Scaled(total.mantissa - term, total.exponent))
