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

# Exponents stop here and at its negative: hypotheses some 10^8 bits behind are no longer told
# apart, nor forgotten.
LOWEST = -(2**27)
ZERO = (0.0, 2 * LOWEST)  # mantissa and exponent of nothing

_LAYOUT = {  # of a float: the integer of its width, mantissa bits, exponent bias
    np.dtype(np.float32): (jnp.int32, 23, 127),
    np.dtype(np.float64): (jnp.int64, 52, 1023),
}


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

    def __add__(self, other: "Scaled") -> "Scaled":
        """The sum."""
        exponent = jnp.maximum(self.exponent, other.exponent)
        return scaled(self.at(exponent) + other.at(exponent), exponent)

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

    def aligned(self, axis: int | tuple[int, ...] | None = None) -> tuple[jax.Array, jax.Array]:
        """Floats to add up along axes, and the power of two they share there (axes kept)."""
        top = jnp.max(self.exponent, axis=axis, keepdims=True)
        return self.at(top), top

    def sum(self, axis: int | tuple[int, ...] | None = None) -> "Scaled":
        """Sum over axes."""
        terms, top = self.aligned(axis)
        total = jnp.sum(terms, axis=axis)
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


def exp2(x: jax.Array, rest: jax.Array | float = 0.0) -> Scaled:
    """2^(x + rest), a small rest kept apart for precision; saturates beyond 10^8 bits.

    Its mantissa is not normalised but within [½, 2].
    """
    rest = jnp.where(jnp.abs(x) < -LOWEST, rest, 0.0)
    x = jnp.clip(x, LOWEST, -LOWEST)
    whole = jnp.round(jax.lax.stop_gradient(x))
    return Scaled(jnp.exp2((x - whole) + rest), whole.astype(jnp.int32))


def less(a: Scaled, b: Scaled) -> jax.Array:
    """Whether a < b."""
    below = (a.exponent == b.exponent) & (a.mantissa < b.mantissa)
    return (a.exponent < b.exponent) | below


def product(numbers: Scaled) -> Scaled:
    """The product along axis 0, normalised once for eight: mantissas < 2^8, exponents in int32."""
    n = len(numbers.mantissa)
    while n > 1:
        eights = [numbers[i : i + 8] for i in range(0, n, 8)]
        products = [
            scaled(reduce(jnp.multiply, eight.mantissa), reduce(jnp.add, eight.exponent))
            for eight in eights
        ]
        numbers = jax.tree.map(lambda *parts: jnp.stack(parts), *products)
        n = len(products)
    return numbers[0]


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
