"""Whole recorded sequences, without a robot."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxreplay.filter import init, predict, update
from jaxreplay.params import Params
from jaxreplay.records import Records


def log_evidence(
    records: Records, params: Params, observations: jax.Array, jump: str = "same_tau"
) -> jax.Array:
    """Log p(Z_1:T) of a recorded sequence: how well the records explain it.

    The base for choosing parameters without a robot. `jax.vmap` runs it over parameters and
    over sequences, of different lengths if the shorter ones are filled up with rows of NaN,
    which have no evidence. Differentiable in σ, in θ_I and θ_τ within their ranges.

    Args:
        records: N records, the sequence not among them.
        params: one set of parameters.
        observations: `[T, n_s]` Z_1 … Z_T; NaN where a sensor gave nothing. NumPy, if the
            records have an offset.
        jump: `"same_tau"` or `"own_tau"`; under the latter it is the evidence of that
            approximation (see :func:`jaxreplay.transition.predict_own_tau`).

    Returns:
        A scalar.

    Raises:
        ValueError: the observations are not rows of n_s values.
    """
    if jnp.ndim(observations) != 2 or jnp.shape(observations)[1] != records.n_sensors:
        raise ValueError(
            f"observations have shape {jnp.shape(observations)}; (T, {records.n_sensors}) is "
            f"needed, a column for each of {', '.join(records.sensor_names)}"
        )
    return _log_evidence(records, params, records.centre(observations), jump)


@partial(jax.jit, static_argnames="jump")
def _log_evidence(records: Records, params: Params, observations: jax.Array, jump: str):
    def step(belief, z):
        belief = predict(records, params, belief, jump)
        return update(records, params, belief, z)

    return jnp.sum(jax.lax.scan(step, init(records, jump), observations)[1])
