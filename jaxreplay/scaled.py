"""Non-negative numbers with an exponent of their own: value = mantissa × 2^exponent.

A hypothesis 200 steps behind weighs 0.05^200, far below the smallest float32, and may still win
later; as a float32 logarithm it would keep five digits. Here it keeps its relative precision at
any size, sums and products stay sums and products, and no logarithm is taken.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import chebyshev

# Exponents stop here and at its negative: hypotheses some 5 × 10^8 bits behind are no longer told
# apart, nor forgotten.
LOWEST = -(2**29)
ZERO = (0.0, 2 * LOWEST)  # mantissa and exponent of nothing

_LAYOUT = {  # of a float: the integer of its width, mantissa bits, exponent bias
    np.dtype(np.float32): (jnp.int32, 23, 127),
    np.dtype(np.float64): (jnp.int64, 52, 1023),
}


_EXP2 = {  # polynomials for 2^x, |x| ≤ ½: relative error 1e-9 (float32), 1e-16
    np.dtype(dtype): chebyshev.cheb2poly(chebyshev.chebinterpolate(lambda y: 2 ** (y / 2), degree))[
        ::-1
    ]
    * 2.0 ** np.arange(degree, -1, -1)
    for dtype, degree in ((np.float32, 6), (np.float64, 12))
}
_ROOM = 12  # bits that a mantissa may be off 1 before it is normalised


class Scaled(NamedTuple):
    """mantissa × 2^exponent; float and int32 arrays of one shape. A zero has mantissa 0."""

    mantissa: jax.Array
    exponent: jax.Array

    def __mul__(self, other: "Scaled") -> "Scaled":
        """The product."""
        return scaled(self.mantissa * other.mantissa, self.exponent + other.exponent)

    def __truediv__(self, other: "Scaled") -> "Scaled":
        """The quotient; 0 / 0 is 0."""
        divisor = jnp.where(other.mantissa == 0, 1.0, other.mantissa)
        return scaled(self.mantissa / divisor, self.exponent - other.exponent)

    def __getitem__(self, index) -> "Scaled":
        """Part of the array."""
        return Scaled(self.mantissa[index], self.exponent[index])

    def at(self, exponent: jax.Array | int) -> jax.Array:
        """In units of 2^exponent, as floats; too small a number is zero."""
        return self.mantissa * _power_of_two(self.exponent - exponent, self.mantissa.dtype)

    def padded(self, columns: tuple[int, int]) -> "Scaled":
        """With columns of zeros before and after the last axis."""
        widths = [(0, 0)] * (self.mantissa.ndim - 1) + [columns]
        parts = zip(self, ZERO, strict=True)
        return Scaled(*(jnp.pad(part, widths, constant_values=zero) for part, zero in parts))

    def sum(self, axis: int | tuple[int, ...] | None = None) -> "Scaled":
        """Sum over axes."""
        top = jnp.max(self.exponent, axis=axis, keepdims=True)
        total = jnp.sum(self.at(top), axis=axis)
        return scaled(total, top.reshape(total.shape))

    def where(self, condition: jax.Array) -> "Scaled":
        """Itself where the condition holds, zero elsewhere."""
        mantissa = jnp.where(condition, self.mantissa, 0.0)
        return Scaled(mantissa, jnp.where(condition, self.exponent, ZERO[1]))

    def value(self) -> jax.Array:
        """As floats."""
        return self.at(0)

    def log(self) -> jax.Array:
        """Natural logarithm, −inf for zero."""
        return jnp.log(self.mantissa) + self.exponent * jnp.asarray(np.log(2), self.mantissa.dtype)


def scaled(mantissa: jax.Array, exponent: jax.Array | int = 0) -> Scaled:
    """A normalised number: mantissa in [1, 2), or 0; the one given below 2^126 (float32)."""
    integer, bits, bias = _LAYOUT[mantissa.dtype]
    pattern = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(mantissa), integer)
    shift = (pattern >> bits).astype(jnp.int32) - bias
    zero = pattern >> bits == 0  # what XLA flushes to zero is zero
    total = jnp.clip(shift + exponent, LOWEST, -LOWEST)
    unit = mantissa * _power_of_two(-shift, mantissa.dtype)
    return Scaled(jnp.where(zero, 0.0, unit), jnp.where(zero, ZERO[1], total))


def exp2(x: jax.Array, rest: jax.Array, near: jax.Array) -> jax.Array:
    """2^(x + rest − near) for an integer near x; a small rest is kept apart for precision."""
    integer, bits, bias = _LAYOUT[x.dtype]
    x = jnp.clip((x - near.astype(x.dtype)) + rest, -_ROOM, _ROOM)
    whole = jnp.round(jax.lax.stop_gradient(x))
    x -= whole
    value = jnp.zeros_like(x)
    for coefficient in _EXP2[x.dtype]:
        value = value * x + float(coefficient)
    power = (whole.astype(integer) << bits) + (bias << bits)
    return value * jax.lax.bitcast_convert_type(power, x.dtype)


def weighted(*terms: tuple[Scaled, Scaled]) -> Scaled:
    """The sum of products."""
    exponents = [a.exponent + b.exponent for a, b in terms]
    top = reduce(jnp.maximum, exponents)
    products = [
        Scaled(a.mantissa * b.mantissa, exponent).at(top)
        for (a, b), exponent in zip(terms, exponents, strict=True)
    ]
    return scaled(sum(products), top)


def less(a: Scaled, b: Scaled) -> jax.Array:
    """Whether a < b."""
    below = (a.exponent == b.exponent) & (a.mantissa < b.mantissa)
    return (a.exponent < b.exponent) | below


def product(numbers: Scaled) -> Scaled:
    """The product along axis 0 of mantissas within 2^±12; the result's within 2^±96."""
    while True:
        n = len(numbers.mantissa)
        eights = [numbers[i : i + 8] for i in range(0, n, 8)]
        products = [
            Scaled(reduce(jnp.multiply, eight.mantissa), reduce(jnp.add, eight.exponent))
            for eight in eights
        ]
        if len(products) == 1:
            return products[0]
        numbers = jax.tree.map(lambda *parts: jnp.stack(parts), *(scaled(*p) for p in products))


def upper_half(x: jax.Array) -> jax.Array:
    """The float with the lower half of its mantissa cut off: products of two such are exact."""
    integer, bits, _ = _LAYOUT[x.dtype]
    pattern = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(x), integer)
    cut = (bits + 2) // 2
    return jax.lax.bitcast_convert_type(pattern >> cut << cut, x.dtype)


def select(condition: jax.Array, chosen: Scaled, other: Scaled) -> Scaled:
    """`jnp.where` for these numbers."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, other)


def _power_of_two(n: jax.Array, dtype: jnp.dtype) -> jax.Array:
    """2^n for integers n, 0 where that is below the smallest normal float."""
    integer, bits, bias = _LAYOUT[np.dtype(dtype)]
    pattern = jnp.clip(n + bias, 0, 2 * bias).astype(integer) << bits
    return jax.lax.bitcast_convert_type(pattern, dtype)
