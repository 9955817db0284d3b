"""Smooth functions as polynomials and quotients of polynomials, fitted once."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import chebyshev
from scipy.special import comb


def fit(function: Callable[[np.ndarray], np.ndarray], degree: int) -> np.ndarray:
    """Return the coefficients of the Chebyshev interpolant on [−1, 1], the highest first."""
    interpolant = chebyshev.chebinterpolate(function, degree)  # pyright: ignore[reportCallIssue, reportArgumentType]
    return chebyshev.cheb2poly(interpolant)[::-1]


def fit_quotients(
    functions: Sequence[Callable[[np.ndarray], np.ndarray]], degree: int, farthest: float
) -> tuple[list[np.ndarray], np.ndarray]:
    """Fit quotients P_k / Q to positive functions f_k on [0, farthest], with one Q for all.

    Q has the degree given and makes the relative error of f_0 small; P_k has degree − 1 − k. The
    basis is Bernstein's, in w / (w + 3), so that `farthest` may be very large.

    Returns:
        The coefficients of all P_k, and those of Q, the highest first. f_0 is exact at 0.
    """
    points = (1 + np.cos(np.pi * (np.arange(100 * degree) + 0.5) / (100 * degree))) / 2
    share = points * farthest / (farthest + 3)  # w / (w + 3)
    w = 3 * share / (1 - share)
    k = np.arange(degree + 1)
    binomials = comb(degree, k)
    basis = binomials * share[:, None] ** k * (1 - share[:, None]) ** (degree - k)
    values = [function(w)[:, None] for function in functions]
    q, weight = np.zeros(degree + 1), 1.0
    for _ in range(8):  # P_0 − f_0 Q is minimised relative to f_0 times the last Q
        system = np.hstack([basis[:, :degree] / values[0], -basis]) / weight
        q = np.linalg.svd(system, full_matrices=False)[2][-1][degree:]
        weight = (basis @ q)[:, None]
    scale = binomials * 3.0**-k / q[0]
    relative = basis / (weight * values[0])
    fitted = [
        np.linalg.lstsq(relative[:, : degree - k], (value / values[0])[:, 0])[0]
        for k, value in enumerate(values)
    ]
    numerators = [p * scale[: len(p)] for p in fitted]
    numerators[0][0] = functions[0](np.zeros(1))[0]  # exact at 0, as Q is 1 there
    return [p[::-1] for p in numerators], (q * scale)[::-1]


def evaluate(coefficients: np.ndarray, x: jax.Array) -> jax.Array:
    """Return the polynomial at x, of any shape, by Horner's scheme."""
    value = jnp.full_like(x, float(coefficients[0]))
    for coefficient in coefficients[1:]:
        value = value * x + float(coefficient)
    return value
