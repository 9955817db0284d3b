"""The numbers of `numba_rival.py`: float32, with an exponent apart so that none underflows."""

import numpy as np
from numba import njit
from numpy.polynomial import chebyshev
from scipy.special import erfcx

FLAGS = {"contract", "nnan", "nsz", "reassoc"}
COMPILED = {"fastmath": FLAGS, "error_model": "numpy", "nogil": True}

F = np.float32  # a plain 0.5 would make Numba compute in float64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
TWELFTH, SQRT_2PI = F(1 / 12), F(np.sqrt(2 * np.pi))

# A number is mantissa × 2^exponent, the exponent an integer stored in a float.
TINY, BIAS = F(2.0**-126), F(127)
NOTHING = F(-(2.0**24))  # the exponent of a zero
LAST_BITS = F(2.0**23 + 127)  # added to an integer, puts it and the bias into the last bits

ROOT = np.sqrt(1 / (2 * np.log(2)))  # exp(−x²/2) = 2^−(ROOT x)²
PER_ROOT = F(1 / ROOT)


def _polynomial(f, degree):
    """Return the Chebyshev interpolant of f on [−1, 1]: float32 coefficients, highest first."""
    return [F(c) for c in chebyshev.cheb2poly(chebyshev.chebinterpolate(f, degree))[::-1]]


def _smooth_mills(y):
    """Return (x + CENTRE) (1 − Φ(x)) / φ(x), y being (x − CENTRE) / (x + CENTRE)."""
    x = CENTRE * (1 + y) / (1 - y)
    return (x + CENTRE) * np.sqrt(np.pi / 2) * erfcx(x / np.sqrt(2))


CENTRE, TWICE_CENTRE = F(3.5), F(7)
M8, M7, M6, M5, M4, M3, M2, M1, M0 = _polynomial(_smooth_mills, 8)
E5, E4, E3, E2, E1, E0 = _polynomial(lambda y: 2 ** (y / 2), 5)


@njit(**COMPILED)
def mills_ratio(x):
    """Return (1 − Φ(x)) / φ(x) for x ≥ 0, to 3e-7."""
    reciprocal = ONE / (x + CENTRE)
    y = ONE - TWICE_CENTRE * reciprocal
    v = (((M8 * y + M7) * y + M6) * y + M5) * y + M4
    v = (((v * y + M3) * y + M2) * y + M1) * y + M0
    return v * reciprocal


@njit(**COMPILED)
def exp2(x):
    """Return 2^x for |x| ≤ ½, to 1e-7."""
    x *= TWO
    return ((((E5 * x + E4) * x + E3) * x + E2) * x + E1) * x + E0


@njit(**COMPILED)
def power_of_two(n):
    """Return 2^n for an integer n ≤ 127 stored in a float, 0 below 2^-126."""
    n = n if n > -BIAS else -BIAS
    return np.int32(np.float32(n + LAST_BITS).view(np.int32) << 23).view(np.float32)


@njit(**COMPILED)
def mantissa(x):
    """Return the mantissa of x > 0, in [1, 2)."""
    return np.int32((np.float32(x).view(np.int32) & 0x7FFFFF) | 0x3F800000).view(np.float32)


@njit(**COMPILED)
def exponent(x):
    """Return the exponent of x ≥ 0, as a float; NOTHING for 0."""
    return F(np.int32(np.float32(x).view(np.int32) >> 23)) - BIAS if x >= TINY else NOTHING


@njit(**COMPILED)
def total(p, p_bits):
    """Return the sum of a row: mantissa and exponent."""
    top = NOTHING
    for j in range(p.size):
        top = max(top, p_bits[j])
    mass = ZERO
    for j in range(p.size):
        mass += p[j] * power_of_two(p_bits[j] - top)
    return mantissa(mass), top + exponent(mass)


@njit(**COMPILED)
def multiply(p, bits, factor, factor_bits):
    """Multiply a row by a number, in place."""
    for j in range(p.size):
        product = p[j] * factor
        p[j] = mantissa(product)
        bits[j] = max(bits[j] + factor_bits + exponent(product), NOTHING)


@njit(**COMPILED)
def highest(bits, top):
    """Replace a row of exponents by the larger of it and another."""
    for j in range(top.size):
        top[j] = max(top[j], bits[j])


@njit(**COMPILED)
def add_at(p, bits, top, mass):
    """Add a row to `mass`, in units of 2^top."""
    for j in range(mass.size):
        mass[j] += p[j] * power_of_two(bits[j] - top[j])
