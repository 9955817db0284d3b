"""Sums, products and quotients as two floats: the rounded result, and its rounding error."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter.numerics.scaled import upper_half

TwoFloats = tuple[jax.Array, jax.Array]


def two_sum(a: jax.Array, b: jax.Array) -> TwoFloats:
    """Return a + b as a float and its rounding error (Knuth)."""
    s = a + b
    b_part = s - a
    return s, (a - (s - b_part)) + (b - b_part)


def two_product(a: jax.Array, b: jax.Array) -> TwoFloats:
    """Return a · b as a float and its rounding error (Dekker)."""
    a_high, b_high = upper_half(a), upper_half(b)
    a_low, b_low = a - a_high, b - b_high
    p = a * b
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


def two_quotient(dividend: float, divisor: TwoFloats) -> TwoFloats:
    """Return dividend / divisor as a float and its rounding error.

    Args:
        dividend: a constant; its rounding error in the working precision is taken into account.
        divisor: any number, as two floats.
    """
    high, low = divisor
    top = jnp.asarray(dividend, high.dtype)
    top_low = float(dividend - np.asarray(dividend, high.dtype).astype(np.float64))
    quotient = top / high
    back, back_low = two_product(quotient, high)
    remainder = ((top - back) - back_low) + (top_low - quotient * low)
    return quotient, remainder / high
