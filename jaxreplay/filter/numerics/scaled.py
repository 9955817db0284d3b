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

# Exponents are clipped to ± this. Hypotheses less probable than 2^LOWEST are all treated as equally
# probable, but not as impossible.
LOWEST = -(2**29)
ZERO = (0.0, 2 * LOWEST)  # mantissa and exponent of 0

_LAYOUT = {  # of floats: the integer type of their width, mantissa bits, exponent bias
    np.dtype(np.float32): (jnp.int32, 23, 127),
    np.dtype(np.float64): (jnp.int64, 52, 1023),
}


_EXP2 = {  # polynomials for 2^x, |x| ≤ ½: relative error 1e-9 (float32), 1e-16 (float64)
    np.dtype(dtype): fit(lambda x: 2 ** (x / 2), degree) * 2.0 ** np.arange(degree, -1, -1)
    for dtype, degree in ((np.float32, 6), (np.float64, 12))
}
_ROOM = 12  # `exp2` clips the exponent of its mantissas to this, either way


@partial(jax.tree_util.register_dataclass, data_fields=["mantissa", "exponent"], meta_fields=[])
@dataclass(frozen=True)
class Scaled:
    """Numbers mantissa × 2^exponent: a float and an int32 array of one shape; 0 has mantissa 0."""

    mantissa: jax.Array
    exponent: jax.Array

    def __mul__(self, other: "Scaled") -> "Scaled":
        """Return the product."""
        return scaled(self.mantissa * other.mantissa, self.exponent + other.exponent)

    def __truediv__(self, other: "Scaled") -> "Scaled":
        """Return the quotient; 0 / 0 is 0."""
        divisor = jnp.where(other.mantissa == 0, 1.0, other.mantissa)
        return scaled(self.mantissa / divisor, self.exponent - other.exponent)

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
        total = jnp.sum(self.at(top), axis=axis)
        return scaled(total, top.reshape(total.shape))

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


def scaled(mantissa: jax.Array, exponent: jax.Array | int = 0) -> Scaled:
    """Return mantissa × 2^exponent normalised: mantissa in [1, 2), or 0.

    The given mantissa may be any float from 0 to 2^126 (float32).
    """
    integer, bits, bias = _LAYOUT[mantissa.dtype]
    pattern = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(mantissa), integer)
    shift = (pattern >> bits).astype(jnp.int32) - bias
    zero = pattern >> bits == 0  # 0, or a subnormal, which XLA flushes to 0
    total = jnp.clip(shift + exponent, LOWEST, -LOWEST)
    unit = mantissa * _power_of_two(-shift, mantissa.dtype)
    return Scaled(jnp.where(zero, 0.0, unit), jnp.where(zero, ZERO[1], total))


def exp2(x: jax.Array, rest: jax.Array, near: jax.Array) -> jax.Array:
    """Return 2^(x + rest − near), clipped to 2^±12.

    `x` and `rest` are the two floats of one number, and `near` is an integer close to it.
    """
    integer, bits, bias = _LAYOUT[x.dtype]
    x = jnp.clip((x - near.astype(x.dtype)) + rest, -_ROOM, _ROOM)
    whole = jnp.round(jax.lax.stop_gradient(x))
    x -= whole
    value = evaluate(_EXP2[x.dtype], x)
    power = (whole.astype(integer) << bits) + (bias << bits)
    return value * jax.lax.bitcast_convert_type(power, x.dtype)


def weighted(*terms: tuple[Scaled, Scaled]) -> Scaled:
    """Return the sum of the products of pairs."""
    exponents = [a.exponent + b.exponent for a, b in terms]
    top = reduce(jnp.maximum, exponents)
    products = [
        Scaled(a.mantissa * b.mantissa, exponent).at(top)
        for (a, b), exponent in zip(terms, exponents, strict=True)
    ]
    return scaled(reduce(jnp.add, products), top)


def less(a: Scaled, b: Scaled) -> jax.Array:
    """Return where a < b."""
    below = (a.exponent == b.exponent) & (a.mantissa < b.mantissa)
    return (a.exponent < b.exponent) | below


def product(numbers: Scaled) -> Scaled:
    """Return the product along axis 0.

    For factors with mantissas within 2^±12 the product's is within 2^±96, not in [1, 2).
    """
    while True:
        n = len(numbers.mantissa)
        eights = [numbers[i : i + 8] for i in range(0, n, 8)]
        products = [
            Scaled(reduce(jnp.multiply, eight.mantissa), reduce(jnp.add, eight.exponent))
            for eight in eights
        ]
        if len(products) == 1:
            return products[0]
        numbers = jax.tree.map(
            lambda *parts: jnp.stack(parts), *(scaled(p.mantissa, p.exponent) for p in products)
        )


def upper_half(x: jax.Array) -> jax.Array:
    """Return x without the lower half of its mantissa; the product of two such floats is exact."""
    integer, bits, _ = _LAYOUT[x.dtype]
    pattern = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(x), integer)
    cut = (bits + 2) // 2
    return jax.lax.bitcast_convert_type(pattern >> cut << cut, x.dtype)


def select(condition: jax.Array, chosen: Scaled, other: Scaled) -> Scaled:
    """Return `chosen` where the condition holds, else `other`."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, other)


def _power_of_two(n: jax.Array, dtype: jnp.dtype) -> jax.Array:
    """Return 2^n for integers n; 0 below the smallest normal float."""
    integer, bits, bias = _LAYOUT[np.dtype(dtype)]
    pattern = jnp.clip(n + bias, 0, 2 * bias).astype(integer) << bits
    return jax.lax.bitcast_convert_type(pattern, dtype)
