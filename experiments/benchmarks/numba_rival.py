"""The filter's step once more as one fused, parallel Numba kernel in float32, without windows.

Written for `filter_step.py` as the rival to beat, and as exact as the filter: equation 2 from one
tail of the normal density per sample, the belief as mantissas and exponents so that no hypothesis
underflows, squares of distances in float64. Replays run side by side on all cores.

The functions are those of `jaxreplay/reference.py`, by the same names. Each works on a row, that
is, one record's moments in one replay: so a row stays in the cache from equation to equation, and
the compiler vectorises every loop. `advance` calls them for all rows and all replays.
The kernel does what the benchmark needs and no more: records of one length, no missing sensors,
θ_I ≤ 1 − 1/N, distances below some 1000 σ.
"""

import numpy as np
from numba import njit, prange
from numba_numbers import (
    COMPILED,
    HALF,
    NOTHING,
    ONE,
    PER_ROOT,
    ROOT,
    SQRT_2PI,
    TINY,
    TWELFTH,
    ZERO,
    F,
    add_at,
    exp2,
    exponent,
    highest,
    mantissa,
    mills_ratio,
    multiply,
    power_of_two,
    total,
)  # fmt: skip

SHORT = F(0.1)  # length × distance, in σ, below which a segment is a sum over its ends
LAST_STEPS = 10  # § 2.2.5


@njit(**COMPILED)
def tails(zeta, z, per_sigma, x, density, bits, tail):
    """Compute of each sample its distance x in σ, exp(−x²/2) = 2^bits × density, and its tail."""
    for j in range(zeta.size):
        distance = (np.float64(zeta[j]) - z) * per_sigma
        log2 = -distance * distance
        whole = np.rint(log2)
        x[j] = F(distance) * PER_ROOT
        bits[j] = F(whole)
        density[j] = exp2(F(log2 - whole))
        tail[j] = density[j] * mills_ratio(abs(x[j]))


@njit(**COMPILED)
def segment_mean(length, per_sigma, x, density, bits, tail, mean, mean_bits):
    """Compute the mean of exp(−x²/2) along each segment, as 2^mean_bits × mean.

    It is an integral of equation 2 times √(2π) σ, which is the same for all states.
    """
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
def likelihood(nodes, lengths, sigma, z, i, rows, p, p_bits):
    """Multiply a row by equation 2 for the moments of record i, times ∏_k √(2π) σ_k.

    It is multiplied into the belief at once: a row of its own would slow a step by 2 %.

    Args:
        nodes: `[n_s, N, L + 2]` samples.
        lengths: `[n_s, N, L + 1]` their differences.
        sigma: `[n_s]` σ.
        z: `[n_s]` observation.
        i: the record.
        rows: `[6, L + 2]` memory to compute in.
        p: `[L]` mantissas of the row; changed.
        p_bits: `[L]` its exponents; changed.
    """
    x, density, bits, tail, mean, mean_bits = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    mean, mean_bits = mean[1:], mean_bits[1:]
    right, right_bits = mean[1:], mean_bits[1:]
    for k in range(len(sigma)):
        per_sigma = 1 / np.float64(sigma[k])
        tails(nodes[k, i], z[k], ROOT * per_sigma, x, density, bits, tail)
        segment_mean(lengths[k, i], F(per_sigma), x, density, bits, tail, mean, mean_bits)
        for j in range(p.size):
            top = max(mean_bits[j], right_bits[j])
            both = mean[j] * power_of_two(mean_bits[j] - top)
            both += right[j] * power_of_two(right_bits[j] - top)
            product = p[j] * HALF * both
            p[j] = mantissa(product)
            p_bits[j] += top + exponent(product)


@njit(**COMPILED)
def record_transition(keep, share, mass, bits, total, total_bits):
    """Apply equation 3 to the mass of one record, in place, at each of its columns.

    Args:
        keep: 1 − θ_I − share.
        share: θ_I / (N − 1).
        mass: `[n]` mantissas of the record's mass.
        bits: `[n]` exponents.
        total: `[n]` mantissas of all records' mass together.
        total_bits: `[n]` exponents.
    """
    for j in range(mass.size):
        top = max(bits[j], total_bits[j])
        landed = keep * mass[j] * power_of_two(bits[j] - top)
        landed += share * total[j] * power_of_two(total_bits[j] - top)
        mass[j] = mantissa(landed)
        bits[j] = max(top + exponent(landed), NOTHING)


@njit(**COMPILED)
def time_transition(theta_tau, p, p_bits, moved, moved_bits):
    """Apply equation 4 along a row, into `moved`; two zeros precede p.

    The last sample absorbs what would pass it.
    """
    stay, step = F(theta_tau), F(1 - 2 * theta_tau)
    p1, p2, bits1, bits2 = p[1:], p[2:], p_bits[1:], p_bits[2:]
    for j in range(moved.size):
        top = max(max(p_bits[j], bits1[j]), bits2[j])
        mass = stay * p2[j] * power_of_two(bits2[j] - top)
        mass += step * p1[j] * power_of_two(bits1[j] - top)
        mass += stay * p[j] * power_of_two(p_bits[j] - top)
        moved[j] = mantissa(mass)
        moved_bits[j] = max(top + exponent(mass), NOTHING)

    top = max(max(p_bits[-3], p_bits[-2]), p_bits[-1])
    mass = p[-1] * power_of_two(p_bits[-1] - top)
    mass += (step + stay) * p[-2] * power_of_two(p_bits[-2] - top)
    mass += stay * p[-3] * power_of_two(p_bits[-3] - top)
    moved[-1] = mantissa(mass)
    moved_bits[-1] = max(top + exponent(mass), NOTHING)


@njit(**COMPILED)
def predict_same_tau(keep, share, p, bits, total, total_bits, evidence, evidence_bits):
    """Complete equation 6 as printed, in a row that `time_transition` has moved.

    The normalising sum of equation 9 is divided out here; records of one length lose nothing.
    """
    record_transition(keep, share, p, bits, total, total_bits)
    multiply(p, bits, ONE / evidence, -evidence_bits)


@njit(**COMPILED)
def predict_own_tau(p, bits, weight, weight_bits, after, after_bits, evidence, evidence_bits):
    """Complete equation 6 in the other reading, in a row that `time_transition` has moved.

    The row's weight before the jump is replaced by that after it, and the normalising sum of
    equation 9 divided out.
    """
    factor = after / evidence / weight
    multiply(p, bits, factor, after_bits - evidence_bits - weight_bits)


@njit(**COMPILED)
def command(p, bits, commands, values, expected):
    """Add a record's part of equation 8, Σ_j v_j p(i, j), to `expected` `[n_u]`."""
    for j in range(p.size):
        values[j] = p[j] * power_of_two(bits[j])
    for u in range(expected.size):
        v, of_record = commands[u], ZERO
        for j in range(p.size):
            of_record += values[j] * v[j]
        expected[u] += of_record


@njit(**COMPILED)
def update(nodes, lengths, sigma, z, i, rows, p, p_bits):
    """Compute equation 9 for record i, in place; the prediction divides by the sum of all rows.

    Arguments are those of `likelihood`.
    """
    likelihood(nodes, lengths, sigma, z, i, rows, p, p_bits)


@njit(**COMPILED)
def end_probability(p, p_bits):
    """Return a row's part of p(τ in the last 10 time steps), § 2.2.5: mantissa and exponent."""
    return total(p[-LAST_STEPS:], p_bits[-LAST_STEPS:])


@njit(parallel=True, **COMPILED)
def advance(
    own_tau, nodes, lengths, commands, theta_i, theta_tau, sigma, belief, bits, z, sent, ended
):
    """Do a control step of every replay: equation 9, § 2.2.5, equations 6 and 8.

    Args:
        own_tau: whether a jump lands where the new record stands.
        nodes: `[n_s, N, L + 2]` samples, mirrored at both ends.
        lengths: `[n_s, N, L + 1]` their differences.
        commands: `[N, n_u, L]`.
        theta_i: `[B]` θ_I.
        theta_tau: `[B]` θ_τ.
        sigma: `[B, n_s]` σ.
        belief: `[B, N, L + 2]` mantissas of the predicted belief, two zeros first; changed.
        bits: `[B, N, L + 2]` its exponents; changed.
        z: `[B, n_s]` observations.
        sent: `[B, n_u]` the command that follows from the next belief; computed.
        ended: `[B]` p(τ in the last 10 time steps); computed.
    """
    _, n, columns = nodes.shape
    for replay in prange(len(z)):
        rows = np.empty((8, columns), F)
        mass, mass_bits = rows[0, 2:], rows[1, 2:]
        moved, moved_bits = np.empty((n, columns - 2), F), np.empty((n, columns - 2), F)
        weight, weight_bits = np.empty(n, F), np.empty(n, F)
        at_end, at_end_bits = np.empty(n, F), np.empty(n, F)
        share = F(theta_i[replay] / (n - 1))
        keep = F(1 - theta_i[replay]) - share

        for i in range(n):
            p, p_bits = belief[replay, i], bits[replay, i]
            update(nodes, lengths, sigma[replay], z[replay], i, rows, p[2:], p_bits[2:])
            at_end[i], at_end_bits[i] = end_probability(p, p_bits)
            time_transition(theta_tau[replay], p, p_bits, moved[i], moved_bits[i])
            weight[i], weight_bits[i] = total(moved[i], moved_bits[i])
        evidence, evidence_bits = total(weight, weight_bits)
        at_end_sum, at_end_sum_bits = total(at_end, at_end_bits)
        ended[replay] = at_end_sum / evidence * power_of_two(at_end_sum_bits - evidence_bits)

        after, after_bits = weight.copy(), weight_bits.copy()
        if own_tau:
            everything = np.full(n, evidence), np.full(n, evidence_bits)
            record_transition(keep, share, after, after_bits, everything[0], everything[1])
        else:
            mass_bits[:] = NOTHING
            mass[:] = ZERO
            for i in range(n):
                highest(moved_bits[i], mass_bits)
            for i in range(n):
                add_at(moved[i], moved_bits[i], mass_bits, mass)
        sent[replay] = ZERO
        for i in range(n):
            p, p_bits = moved[i], moved_bits[i]
            if own_tau:
                predict_own_tau(
                    p, p_bits, weight[i], weight_bits[i], after[i], after_bits[i],
                    evidence, evidence_bits,
                )  # fmt: skip
            else:
                predict_same_tau(keep, share, p, p_bits, mass, mass_bits, evidence, evidence_bits)
            command(p, p_bits, commands[i], rows[2, 2:], sent[replay])
            belief[replay, i, 2:] = p
            bits[replay, i, 2:] = p_bits


@njit(parallel=True, **COMPILED)
def only_tails(rows):
    """Compute the tails of some rows in cache, for their cost alone; return how many tails."""
    for _ in prange(rows):
        zeta, scratch = np.ones(1000, F), np.empty((4, 1000), F)
        for k in range(100):
            tails(zeta, F(k) / 100, 1.0, scratch[0], scratch[1], scratch[2], scratch[3])
    return rows * 100 * 1000
