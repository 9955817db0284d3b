"""How far an observation is from the state that a belief follows: is the robot lost?"""

import jax
import jax.numpy as jnp

from jaxreplay.filter.belief import Belief
from jaxreplay.filter.numerics.anchor import highest, measured
from jaxreplay.filter.window import view
from jaxreplay.params import Params
from jaxreplay.records import Records


def distance(records: Records, params: Params, belief: Belief, z: jax.Array) -> jax.Array:
    """Compute the distance from an observation to the sample of the most probable state.

        max_k |z_k − ζ_k| / σ_k

    Args:
        records: N records, centred.
        params: σ is used.
        belief: p(I_t, τ_t | Z_{1:t}), updated with z.
        z: `[n_s]` the centred observation Z_t; NaN marks a missing sensor, which does not count.

    Returns:
        A scalar in σ.
    """
    stored = view(records, belief)
    z, inverse = measured(stored, params.sigma, z)
    i, j = highest(belief.p.value())
    return jnp.max(jnp.abs(stored.nodes[:, i, j + 1] - z) * inverse)
