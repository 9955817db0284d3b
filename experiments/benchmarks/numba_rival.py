"""The filter's step once more as one fused, parallel Numba kernel in float32, without windows.

Written for `filter_step.py` as the rival to beat, and as exact as the filter: equation 2 from one
tail of the normal density per sample, the belief as mantissas and exponents so that no hypothesis
underflows, squares of distances in float64. Replays run side by side on all cores; within one,
every loop runs along a row (one record's moments) and is vectorised by the compiler.
It does what the benchmark needs and no more: records of one length, no missing sensors,
θ_I ≤ 1 − 1/N, distances below some 1000 σ.
"""

import numpy as np
from numba import njit, prange
from numpy.polynomial import chebyshev
from scipy.special import erfcx

FLAGS = {"contract", "nnan", "nsz", "reassoc"}
COMPILED = {"fastmath": FLAGS, "error_model": "numpy", "nogil": True}

F = np.float32  # a plain 0.5 would make Numba compute in float64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
TWELFTH, SQRT_2PI = F(1 / 12), F(np.sqrt(2 * np.pi))
SHORT = F(0.1)  # length × distance, in σ, below which a segment is a sum over its ends
LAST_STEPS = 10  # § 2.2.5

# A number is mantissa × 2^exponent, the exponent an integer held in a float.
TINY, BIAS = F(2.0**-126), F(127)
NOTHING = F(-(2.0**24))  # the exponent of a zero
LAST_BITS = F(2.0**23 + 127)  # added to an integer, puts it and the bias into the last bits

ROOT = np.sqrt(1 / (2 * np.log(2)))  # exp(−x²/2) = 2^−(ROOT x)²
PER_ROOT = F(1 / ROOT)


def _polynomial(f, degree):
    """The Chebyshev interpolant of f on [−1, 1], as float32 coefficients, highest first."""
    return [F(c) for c in chebyshev.cheb2poly(chebyshev.chebinterpolate(f, degree))[::-1]]


def _smooth_mills(y):
    """(x + CENTRE) (1 − Φ(x)) / φ(x), y being (x − CENTRE) / (x + CENTRE)."""
    x = CENTRE * (1 + y) / (1 - y)
    return (x + CENTRE) * np.sqrt(np.pi / 2) * erfcx(x / np.sqrt(2))


CENTRE, TWICE_CENTRE = F(3.5), F(7)
M8, M7, M6, M5, M4, M3, M2, M1, M0 = _polynomial(_smooth_mills, 8)
E5, E4, E3, E2, E1, E0 = _polynomial(lambda y: 2 ** (y / 2), 5)


@njit(**COMPILED)
def mills_ratio(x):
    """(1 − Φ(x)) / φ(x) for x ≥ 0, to 3e-7."""
    reciprocal = ONE / (x + CENTRE)
    y = ONE - TWICE_CENTRE * reciprocal
    v = (((M8 * y + M7) * y + M6) * y + M5) * y + M4
    v = (((v * y + M3) * y + M2) * y + M1) * y + M0
    return v * reciprocal


@njit(**COMPILED)
def exp2(x):
    """2^x for |x| ≤ ½, to 1e-7."""
    x *= TWO
    return ((((E5 * x + E4) * x + E3) * x + E2) * x + E1) * x + E0


@njit(**COMPILED)
def power_of_two(n):
    """2^n for an integer n ≤ 127 held in a float, 0 below 2^-126."""
    n = n if n > -BIAS else -BIAS
    return np.int32(np.float32(n + LAST_BITS).view(np.int32) << 23).view(np.float32)


@njit(**COMPILED)
def mantissa(x):
    """Of x > 0, in [1, 2)."""
    return np.int32((np.float32(x).view(np.int32) & 0x7FFFFF) | 0x3F800000).view(np.float32)


@njit(**COMPILED)
def exponent(x):
    """Of x ≥ 0, as a float; NOTHING for 0."""
    return F(np.int32(np.float32(x).view(np.int32) >> 23)) - BIAS if x >= TINY else NOTHING


@njit(**COMPILED)
def tails(zeta, z, per_sigma, x, density, bits, tail):
    """At each sample: its distance in σ, 2^bits × density = exp(−x²/2), and the tail beyond."""
    for j in range(zeta.size):
        distance = (np.float64(zeta[j]) - z) * per_sigma
        log2 = -distance * distance
        whole = np.rint(log2)
        x[j] = F(distance) * PER_ROOT
        bits[j] = F(whole)
        density[j] = exp2(F(log2 - whole))
        tail[j] = density[j] * mills_ratio(abs(x[j]))


@njit(**COMPILED)
def segments(length, per_sigma, x, density, bits, tail, mean, mean_bits):
    """The mean of exp(−x²/2) along each segment, 2^mean_bits × mean."""
    x_end, density_end, bits_end, tail_end = x[1:], density[1:], bits[1:], tail[1:]
    for j in range(length.size):
        x_a, x_b = x[j], x_end[j]
        between = (x_a < ZERO) != (x_b < ZERO)
        top = ZERO if between else max(bits[j], bits_end[j])
        scale_a, scale_b = power_of_two(bits[j] - top), power_of_two(bits_end[j] - top)
        a, b = density[j] * scale_a, density_end[j] * scale_b
        tail_a, tail_b = tail[j] * scale_a, tail_end[j] * scale_b
        integral = SQRT_2PI - tail_a - tail_b if between else abs(tail_a - tail_b)

        # Where the tails cancel: Euler and Maclaurin's sum of the two ends.
        d = length[j] * per_sigma
        by_ends = HALF * (a + b) + TWELFTH * d * (b * x_b - a * x_a)
        reach = max(max(abs(x_a), abs(x_b)), ONE)
        value = by_ends if abs(d) * reach < SHORT else integral / abs(d)
        mean[j] = max(value, TINY)
        mean_bits[j] = top


@njit(**COMPILED)
def multiply_states(mean, mean_bits, p, p_bits):
    """Multiply a row of beliefs by one sensor's share of equation 2."""
    right, right_bits = mean[1:], mean_bits[1:]
    for j in range(p.size):
        top = max(mean_bits[j], right_bits[j])
        both = mean[j] * power_of_two(mean_bits[j] - top)
        both += right[j] * power_of_two(right_bits[j] - top)
        product = p[j] * HALF * both
        p[j] = mantissa(product)
        p_bits[j] += top + exponent(product)


@njit(**COMPILED)
def total(p, p_bits):
    """The sum of a row, as mantissa and exponent."""
    top = NOTHING
    for j in range(p.size):
        top = max(top, p_bits[j])
    mass = ZERO
    for j in range(p.size):
        mass += p[j] * power_of_two(p_bits[j] - top)
    return mantissa(mass), top + exponent(mass)


@njit(**COMPILED)
def step_along(p, p_bits, stay, one, moved, moved_bits):
    """Equation 4 along a row; p is preceded by two zeros."""
    p1, p2, bits1, bits2 = p[1:], p[2:], p_bits[1:], p_bits[2:]
    for j in range(moved.size):
        top = max(max(p_bits[j], bits1[j]), bits2[j])
        mass = stay * p2[j] * power_of_two(bits2[j] - top)
        mass += one * p1[j] * power_of_two(bits1[j] - top)
        mass += stay * p[j] * power_of_two(p_bits[j] - top)
        moved[j] = mantissa(mass)
        moved_bits[j] = max(top + exponent(mass), NOTHING)


@njit(**COMPILED)
def absorb(p, p_bits, stay, one, moved, moved_bits):
    """The last sample of a row, which keeps what would pass it."""
    top = max(max(p_bits[-3], p_bits[-2]), p_bits[-1])
    mass = p[-1] * power_of_two(p_bits[-1] - top)
    mass += (one + stay) * p[-2] * power_of_two(p_bits[-2] - top)
    mass += stay * p[-3] * power_of_two(p_bits[-3] - top)
    moved[-1] = mantissa(mass)
    moved_bits[-1] = max(top + exponent(mass), NOTHING)


@njit(**COMPILED)
def highest(bits, top):
    """The larger of two rows of exponents."""
    for j in range(top.size):
        top[j] = max(top[j], bits[j])


@njit(**COMPILED)
def add_at(p, bits, top, mass):
    """Add a row in units of 2^top."""
    for j in range(mass.size):
        mass[j] += p[j] * power_of_two(bits[j] - top[j])


@njit(**COMPILED)
def jump(p, bits, keep, share, mass, mass_bits):
    """Equation 3 on a row: keep p's share and add that of all records' mass."""
    for j in range(p.size):
        top = max(bits[j], mass_bits[j])
        landed = keep * p[j] * power_of_two(bits[j] - top)
        landed += share * mass[j] * power_of_two(mass_bits[j] - top)
        p[j] = mantissa(landed)
        bits[j] = max(top + exponent(landed), NOTHING)


@njit(**COMPILED)
def multiply(p, bits, factor, factor_bits):
    """A row times a number."""
    for j in range(p.size):
        product = p[j] * factor
        p[j] = mantissa(product)
        bits[j] = max(bits[j] + factor_bits + exponent(product), NOTHING)


@njit(**COMPILED)
def expect(p, bits, commands, values, command):
    """Add a row's share of equation 8."""
    for j in range(p.size):
        values[j] = p[j] * power_of_two(bits[j])
    for u in range(command.size):
        row, expected = commands[u], ZERO
        for j in range(p.size):
            expected += values[j] * row[j]
        command[u] += expected


@njit(parallel=True, **COMPILED)
def advance(
    own_tau, nodes, lengths, commands, theta_i, theta_tau, sigma, z, belief, bits, command, ended
):
    """A step of every replay: equation 9, § 2.2.5, equations 6 and 8.

    Args:
        own_tau: which reading of a jump.
        nodes: `[n_s, N, L + 2]` samples, at both ends mirrored.
        lengths: `[n_s, N, L + 1]` their differences.
        commands: `[N, n_u, L]`.
        theta_i: `[B]` θ_I.
        theta_tau: `[B]` θ_τ.
        sigma: `[B, n_s]` σ.
        z: `[B, n_s]` observations.
        belief: `[B, N, L + 2]` mantissas of the predicted belief, two zeros first; changed.
        bits: `[B, N, L + 2]` its exponents; changed.
        command: `[B, n_u]` what follows from the next belief.
        ended: `[B]` p(τ in the last samples).
    """
    n_sensors, n, columns = nodes.shape
    for replay in prange(len(z)):
        rows = np.empty((9, columns), F)
        x, density, density_bits, tail = rows[0], rows[1], rows[2], rows[3]
        mean, mean_bits = rows[4, 1:], rows[5, 1:]
        values, mass, mass_bits = rows[6, 2:], rows[7, 2:], rows[8, 2:]
        moved, moved_bits = np.empty((n, columns - 2), F), np.empty((n, columns - 2), F)
        weight, weight_bits = np.empty(n, F), np.empty(n, F)
        stay, one = F(theta_tau[replay]), F(1 - 2 * theta_tau[replay])
        share = F(theta_i[replay] / (n - 1))
        keep = F(1 - theta_i[replay]) - share

        at_end, at_end_bits = np.empty(n, F), np.empty(n, F)
        for i in range(n):
            p, p_bits = belief[replay, i], bits[replay, i]
            for k in range(n_sensors):
                per_sigma = 1 / np.float64(sigma[replay, k])
                tails(nodes[k, i], z[replay, k], ROOT * per_sigma, x, density, density_bits, tail)
                segments(
                    lengths[k, i], F(per_sigma), x, density, density_bits, tail, mean, mean_bits
                )
                multiply_states(mean, mean_bits, p[2:], p_bits[2:])
            at_end[i], at_end_bits[i] = total(p[-LAST_STEPS:], p_bits[-LAST_STEPS:])
            step_along(p, p_bits, stay, one, moved[i], moved_bits[i])
            absorb(p, p_bits, stay, one, moved[i], moved_bits[i])
            weight[i], weight_bits[i] = total(moved[i], moved_bits[i])
        evidence, evidence_bits = total(weight, weight_bits)
        at_end_sum, at_end_sum_bits = total(at_end, at_end_bits)
        ended[replay] = at_end_sum / evidence * power_of_two(at_end_sum_bits - evidence_bits)

        if not own_tau:
            mass_bits[:] = NOTHING
            mass[:] = ZERO
            for i in range(n):
                highest(moved_bits[i], mass_bits)
            for i in range(n):
                add_at(moved[i], moved_bits[i], mass_bits, mass)
        command[replay] = ZERO
        for i in range(n):
            p, p_bits = moved[i], moved_bits[i]
            if own_tau:
                kept = keep * weight[i] * power_of_two(weight_bits[i] - evidence_bits)
                factor = (kept + share * evidence) / evidence / weight[i]
                multiply(p, p_bits, factor, -weight_bits[i])
            else:
                jump(p, p_bits, keep, share, mass, mass_bits)
                multiply(p, p_bits, ONE / evidence, -evidence_bits)
            expect(p, p_bits, commands[i], values, command[replay])
            belief[replay, i, 2:] = p
            bits[replay, i, 2:] = p_bits


@njit(parallel=True, **COMPILED)
def only_tails(rows):
    """Compute the tails of some rows in cache, for their cost alone; tells how many tails."""
    for _ in prange(rows):
        zeta, scratch = np.ones(1000, F), np.empty((4, 1000), F)
        for k in range(100):
            tails(zeta, F(k) / 100, 1.0, scratch[0], scratch[1], scratch[2], scratch[3])
    return rows * 100 * 1000
