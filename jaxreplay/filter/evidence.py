"""The evidence of whole recorded sequences: how well records and parameters explain them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter.belief import DEFAULT_JUMP, Jump
from jaxreplay.filter.steps import init, predict, update
from jaxreplay.params import Params
from jaxreplay.records import Records


def log_evidence(
    records: Records,
    params: Params,
    observations: np.ndarray | jax.Array,
    jump: Jump = DEFAULT_JUMP,
) -> jax.Array:
    """Compute log p(Z_1:T) = Σ_t log p(Z_t | Z_{1:t−1}) of a recorded sequence.

    It measures how well records and parameters explain the sequence, so that parameters can be
    chosen without a robot. `jax.vmap` runs it over parameters and over sequences; sequences of
    different lengths are filled up with rows of NaN, which add 0. Differentiable in σ,
    and in θ_I and θ_τ inside their ranges.

    Args:
        records: N records, the sequence not among them.
        params: one set of parameters.
        observations: `[T, n_s]` Z_1 … Z_T in the sensors' units; NaN marks a missing sensor. Where
            the records have an offset (see :class:`jaxreplay.Records`), give NumPy arrays; under
            `jax.vmap`, give `records.centred()` and `records.centre(observations)`.
        jump: `"same_tau"` or `"own_tau"`; under the latter it is the evidence of that
            approximation (see :func:`jaxreplay.filter.transition.predict_own_tau`).

    Returns:
        A scalar.

    Raises:
        ValueError: the observations are not rows of n_s values, or one is infinite, or σ does not
            have n_s values.
    """
    if jnp.ndim(observations) != 2 or jnp.shape(observations)[1] != records.n_sensors:
        raise ValueError(
            f"observations have shape {jnp.shape(observations)}; (T, {records.n_sensors}) is "
            f"needed, a column for each of {', '.join(records.sensor_names)}"
        )
    observations = records.centre(observations)
    records.check_finite("observations", observations)
    return _log_evidence(records.centred(), params, observations, jump)


@partial(jax.jit, static_argnames="jump")
def _log_evidence(records, params, observations, jump):
    def step(belief, z):
        return update(records, params, predict(records, params, belief), z)

    return jnp.sum(jax.lax.scan(step, init(records, jump), observations)[1])
