"""The n_s + 2 parameters of the model (§ 2.2.1)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np


@jax.tree_util.register_pytree_with_keys_class
@dataclass(frozen=True)
class Params:
    """θ_I, θ_τ and one σ per sensor; traced values, so each replay of a batch has its own.

    A leading batch axis is allowed on all three; `jax.vmap` over a `Params` then runs one
    replay per row.

    Attributes:
        theta_i: θ_I, probability to jump to another record at a step, in [0, 1].
        theta_tau: θ_τ, probability to stay, and as much to skip one sample, in [0, ½].
        sigma: `[n_s]` σ, the scale on which two values of a sensor differ, in its unit, > 0.

    Raises:
        ValueError: a concrete value is not a finite number of its range. Tracers pass.
    """

    theta_i: jax.Array
    theta_tau: jax.Array
    sigma: jax.Array

    def __post_init__(self):
        for name, symbol, low, high in (
            ("theta_i", "θ_I", 0.0, 1.0),
            ("theta_tau", "θ_τ", 0.0, 0.5),
            ("sigma", "σ", None, np.inf),
        ):
            value = _as_array(getattr(self, name), name)
            object.__setattr__(self, name, value)
            if isinstance(value, jax.core.Tracer):
                continue
            given = np.asarray(value)
            good = np.isfinite(given)
            good &= given > 0 if low is None else (given >= low) & (given <= high)
            if not good.all():
                bad = given if given.ndim == 0 else given[~good].flat[0]
                allowed = "> 0 and finite" if low is None else f"in [{low:g}, {high:g}]"
                raise ValueError(f"{name} ({symbol}) must be {allowed}; got {bad:.6g}")
        if self.sigma.ndim == 0:
            raise ValueError("sigma (σ) needs one value per sensor, e.g. [0.1] for one sensor")

    def tree_flatten_with_keys(self):
        """For JAX: the three values are the leaves."""
        key = jax.tree_util.GetAttrKey
        names = ("theta_i", "theta_tau", "sigma")
        return [(key(name), getattr(self, name)) for name in names], None

    @classmethod
    def tree_unflatten(cls, _, leaves):
        """For JAX, which may put anything in the leaves' place: no check here."""
        params = object.__new__(cls)
        for name, leaf in zip(("theta_i", "theta_tau", "sigma"), leaves, strict=True):
            object.__setattr__(params, name, leaf)
        return params


def _as_array(value, name: str) -> jax.Array:
    try:
        return jnp.asarray(value, dtype=jax.dtypes.canonicalize_dtype(np.float64))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is not a number or an array of numbers: {error}") from None
