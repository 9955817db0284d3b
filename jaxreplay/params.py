"""The n_s + 2 parameters of the model (§ 2.2.1)."""

from __future__ import annotations  # help() then shows ArrayLike, not its ten members

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from numpy.typing import ArrayLike

from jaxreplay.errors import ConfigError, suggest
from jaxreplay.machine import read_toml

_NAMES = ("theta_i", "theta_tau", "sigma")


@jax.tree_util.register_pytree_with_keys_class
@dataclass(frozen=True, init=False)
class Params:
    """θ_I, θ_τ and one σ for each sensor, as arrays in the working precision.

    They are a pytree of three leaves, so that the values are traced, not compiled in. All three
    may have a leading batch axis; `jax.vmap` over a `Params` then computes one replay for each
    row.

    Attributes:
        theta_i: `[]` θ_I, the probability of a jump to another record at a step, in [0, 1].
        theta_tau: `[]` θ_τ, the probability to stay at the same sample in a step, and equally
            that to skip one sample, in [0, ½].
        sigma: `[n_s]` σ, the scale on which two values of a sensor count as different, in the
            sensor's own unit, > 0.
    """

    theta_i: jax.Array
    theta_tau: jax.Array
    sigma: jax.Array

    def __init__(self, theta_i: ArrayLike, theta_tau: ArrayLike, sigma: ArrayLike):
        """Convert the values to arrays and check them; tracers, whose values are unknown, pass.

        Raises:
            ValueError: a value is not a number, not finite or out of its range, or sigma is a
                single number.
        """
        for name, symbol, given, low, high in (
            ("theta_i", "θ_I", theta_i, 0.0, 1.0),
            ("theta_tau", "θ_τ", theta_tau, 0.0, 0.5),
            ("sigma", "σ", sigma, None, np.inf),
        ):
            value = _as_array(given, name)
            object.__setattr__(self, name, value)
            if isinstance(value, Tracer):
                continue
            cast = np.asarray(value)
            good = np.isfinite(cast)
            good &= cast > 0 if low is None else (cast >= low) & (cast <= high)
            if not good.all():
                bad = cast if cast.ndim == 0 else cast[~good].flat[0]
                allowed = "> 0 and finite" if low is None else f"in [{low:g}, {high:g}]"
                raise ValueError(f"{name} ({symbol}) must be {allowed}; got {bad:.6g}")
        if self.sigma.ndim == 0:
            raise ValueError("sigma (σ) needs one value per sensor, e.g. [0.1] for one sensor")

    @classmethod
    def load(cls, path: str | Path) -> Params:
        """Read the parameters in a TOML file that `jaxreplay tune` wrote.

        The file contains `theta_i`, `theta_tau` and a table `[sigma]` of one σ per sensor, by the
        sensors' names and in the order of the records. The names are not compared with those of
        any records.

        Args:
            path: the TOML file.

        Raises:
            ConfigError: the file is missing or not TOML, a key is missing or unknown, or a value
                is not a number or out of its range.
        """
        given = read_toml(Path(path))
        for name in given:
            if name not in _NAMES:
                raise ConfigError(f"{path}: unknown key {suggest(name, _NAMES)}")
        for name in _NAMES:
            if name not in given:
                raise ConfigError(f"{path}: {name} is missing; jaxreplay tune writes such a file")
        sigma = given["sigma"]
        if not isinstance(sigma, dict) or not sigma:
            raise ConfigError(f"{path}: sigma must be a table, [sigma], of one number per sensor")
        thetas = {name: given[name] for name in ("theta_i", "theta_tau")}
        for name, value in (thetas | {f"sigma.{name}": s for name, s in sigma.items()}).items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ConfigError(f"{path}: {name} must be a number; got {value!r}")
        try:
            return cls(**thetas, sigma=[float(value) for value in sigma.values()])
        except (ValueError, OverflowError) as error:
            raise ConfigError(f"{path}: {error}") from None

    def tree_flatten_with_keys(self) -> tuple[Iterable[tuple[Any, Any]], None]:
        """Return the three values as leaves with their names, for JAX."""
        return [(jax.tree_util.GetAttrKey(name), getattr(self, name)) for name in _NAMES], None

    @classmethod
    def tree_unflatten(cls, _: None, leaves: Iterable[Any]) -> Params:
        """Return parameters with these leaves, unchecked: JAX also puts placeholders there."""
        params = object.__new__(cls)
        for name, leaf in zip(_NAMES, leaves, strict=True):
            object.__setattr__(params, name, leaf)
        return params


def _as_array(value: Any, name: str) -> jax.Array:
    """Return a value as an array in the working precision."""
    try:
        return jnp.asarray(value, dtype=jax.dtypes.canonicalize_dtype(np.float64))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is not a number or an array of numbers: {error}") from None
