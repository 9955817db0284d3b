"""Non-negative numbers with an exponent of their own: value = mantissa × 2^exponent.

The probability of a hypothesis that lags 200 steps is some 0.05^200, far below the smallest
float32, and the hypothesis may still win later. A float32 logarithm would keep five digits of it.
Here it keeps its relative precision at any size, sums and products stay sums and products, and no
logarithm is computed.
"""

from dataclasses import dataclass
from functools import partial, reduce

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter.numerics.polynomial import evaluate, fit
from jaxreplay.filter.numerics.stage import stage

# Exponents are clipped to ± this. Hypotheses less probable than 2^LOWEST are all treated as equally
# probable, but not as impossible.
LOWEST = -(2**29)
ZERO = (0.0, 2 * LOWEST)  # mantissa and exponent of 0

_LAYOUT = {  # of floats: the integer type of their width, mantissa bits, exponent bias
    np.dtype(np.float32): (jnp.int32, 23, 127),
    np.dtype(np.float64): (jnp.int64, 52, 1023),
}


_EXP2 = {  # polynomials for (2^x − 1) / x, |x| ≤ ½: error of 2^x 1e-7 (float32), 1e-15 (float64)
    np.dtype(dtype): fit(lambda x: 2 * np.expm1(x / 2 * np.log(2)) / x, degree)
    * 2.0 ** np.arange(degree, -1, -1)
    for dtype, degree in ((np.float32, 5), (np.float64, 9))
}
_LOG2_E = float(1 / np.log(2))
# log 2 as a float of few digits, whose product with an integer is exact, and the rest.
_LOG_2 = (0.693359375, float(np.log(2) - 0.693359375))


@partial(jax.tree_util.register_dataclass, data_fields=["mantissa", "exponent"], meta_fields=[])
@dataclass(frozen=True)
class Scaled:
    """Numbers mantissa × 2^exponent: a float and an int32 array of one shape; 0 has mantissa 0.

    Sums are normalised, that is, have mantissas in [1, 2). Products and quotients are not, as this
    would take longer than they do; a few in a row stay far within a float's range.
    """

    mantissa: jax.Array
    exponent: jax.Array

    def __mul__(self, other: "Scaled") -> "Scaled":
        """Return the product, its mantissas not normalised."""
        exponent = jnp.maximum(self.exponent + other.exponent, ZERO[1])  # in range for the next
        return Scaled(self.mantissa * other.mantissa, exponent)

    def __truediv__(self, other: "Scaled") -> "Scaled":
        """Return the quotient, its mantissas not normalised; 0 / 0 is 0."""
        zero = other.mantissa == 0
        divisor = jnp.where(zero, 1.0, other.mantissa)
        exponent = self.exponent - jnp.where(zero, 0, other.exponent)
        return Scaled(self.mantissa / divisor, jnp.maximum(exponent, ZERO[1]))

    def __getitem__(self, index) -> "Scaled":
        """Return part of the arrays."""
        return Scaled(self.mantissa[index], self.exponent[index])

    def at(self, exponent: jax.Array | int) -> jax.Array:
        """Return floats in units of 2^exponent; a number too small for a float becomes 0."""
        return self.mantissa * _power_of_two(self.exponent - exponent, self.mantissa.dtype)

    def padded(self, columns: tuple[int, int]) -> "Scaled":
        """Return the array with columns of zeros before and after it along the last axis."""
        widths = [(0, 0)] * (self.mantissa.ndim - 1) + [columns]
        parts = ((self.mantissa, ZERO[0]), (self.exponent, ZERO[1]))
        return Scaled(*(jnp.pad(part, widths, constant_values=zero) for part, zero in parts))

    def sum(self, axis: int | tuple[int, ...] | None = None) -> "Scaled":
        """Return the sum over axes, over all if None."""
        top = jnp.max(self.exponent, axis=axis, keepdims=True)
        # Stored first: XLA's library on CPU takes 13 µs for a sum of products, 1 for one of floats.
        total = jnp.sum(_staged_at(self, top), axis=axis)
        # Beyond the limits of its terms, which are products: a sum that is clipped to them would
        # not be the sum.
        return _scaled_sum(total, top.reshape(total.shape))

    def where(self, condition: jax.Array) -> "Scaled":
        """Return the numbers where the condition holds, 0 elsewhere."""
        mantissa = jnp.where(condition, self.mantissa, 0.0)
        return Scaled(mantissa, jnp.where(condition, self.exponent, ZERO[1]))

    def value(self) -> jax.Array:
        """Return floats; numbers below the smallest normal float become 0."""
        return self.at(0)

    def log(self) -> jax.Array:
        """Return the natural logarithm, −∞ for 0."""
        return jnp.log(self.mantissa) + self.exponent * jnp.asarray(np.log(2), self.mantissa.dtype)


_staged_at = stage(Scaled.at)


def scaled(mantissa: jax.Array, exponent: jax.Array | int = 0, lowest: int = LOWEST) -> Scaled:
    """Return mantissa × 2^exponent normalised: mantissa in [1, 2), or 0.

    Args:
        mantissa: any floats from 0 to 2^126 (float32).
        exponent: integers.
        lowest: the exponent is clipped to ± this.
    """
    integer, bits, bias = _LAYOUT[mantissa.dtype]
    pattern = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(mantissa), integer)
    shift = (pattern >> bits).astype(jnp.int32) - bias
    zero = pattern >> bits == 0  # 0, or a subnormal, which XLA flushes to 0
    total = jnp.clip(shift + exponent, lowest, -lowest)
    unit = mantissa * _power_of_two(-shift, mantissa.dtype)
    return Scaled(jnp.where(zero, 0.0, unit), jnp.where(zero, ZERO[1], total))


@stage
def _scaled_sum(total: jax.Array, top: jax.Array) -> Scaled:
    return scaled(total, top, 2 * LOWEST - 2**16)


def exp(x: jax.Array) -> Scaled:
    """Return e^x, of any size; mantissas are not in [1, 2)."""
    whole = jnp.clip(jnp.round(jax.lax.stop_gradient(x) * _LOG2_E), LOWEST, -LOWEST)
    rest = ((x - whole * _LOG_2[0]) - whole * _LOG_2[1]) * _LOG2_E
    return Scaled(_exp2(jnp.clip(rest, -1, 1)), whole.astype(jnp.int32))


def exp_minus(x: jax.Array) -> jax.Array:
    """Return e^−x for x ≥ 0; below the smallest normal float, 0."""
    *_, bias = _LAYOUT[x.dtype]
    x = jnp.minimum(x * _LOG2_E, bias)
    whole = jnp.round(jax.lax.stop_gradient(x))
    return _exp2(whole - x) * _power_of_two(-whole.astype(jnp.int32), x.dtype)


def weighted(*terms: tuple[Scaled, Scaled]) -> Scaled:
    """Return the sum of the products of pairs."""
    products = [a * b for a, b in terms]
    top = reduce(jnp.maximum, [product.exponent for product in products])
    return scaled(reduce(jnp.add, [product.at(top) for product in products]), top)


def less(a: Scaled, b: Scaled) -> jax.Array:
    """Return where a < b."""
    below = (a.exponent == b.exponent) & (a.mantissa < b.mantissa)
    return (a.exponent < b.exponent) | below


def _exp2(x: jax.Array) -> jax.Array:
    return 1 + x * evaluate(_EXP2[x.dtype], x)


def select(condition: jax.Array, chosen: Scaled, other: Scaled) -> Scaled:
    """Return `chosen` where the condition holds, else `other`."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, other)


def _power_of_two(n: jax.Array, dtype: jnp.dtype) -> jax.Array:
    """Return 2^n for integers n; 0 below the smallest normal float."""
    integer, bits, bias = _LAYOUT[np.dtype(dtype)]
    pattern = jnp.clip(n + bias, 0, 2 * bias).astype(integer) << bits
    return jax.lax.bitcast_convert_type(pattern, dtype)
