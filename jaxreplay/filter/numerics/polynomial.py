"""Smooth functions as polynomials, fitted once and evaluated without branches."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import chebyshev


def fit(function: Callable[[np.ndarray], np.ndarray], degree: int) -> np.ndarray:
    """Return the coefficients of the Chebyshev interpolant on [−1, 1], the highest first."""
    interpolant = chebyshev.chebinterpolate(function, degree)  # pyright: ignore[reportCallIssue, reportArgumentType]
    return chebyshev.cheb2poly(interpolant)[::-1]


def evaluate(coefficients: np.ndarray, x: jax.Array) -> jax.Array:
    """Return the polynomial at x, of any shape, by Horner's scheme."""
    value = jnp.zeros_like(x)
    for coefficient in coefficients:
        value = value * x + float(coefficient)
    return value
