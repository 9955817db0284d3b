"""The filter's step in NumPy and SciPy, float64, for `filter_step.py`.

The functions are those of `jaxreplay/reference.py`, by the same names, written to be fast: arrays
over records and moments, SciPy's erfc once a sample and sensor, and plain probabilities instead of
logarithms. What falls below 1e-308 is lost, which at ordinary distances matters to no digit shown.
All write into memory that is allocated once for each replay. They need records of one length and
all sensors measured.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import erfc

from jaxreplay.reference import LAST_STEPS, Params

SHORT = 1e-5  # σ, below which a segment is the point Gaussian at its middle


class Records(NamedTuple):
    """N records of L samples.

    Attributes:
        sensors: `[n_s, N, L]` samples ζ.
        commands: `[n_u, N, L]` commands v.
        per_length: `[n_s, N, L − 1]` 1 / length of each segment; 0 for a short one.
        short: for each sensor, the indices of its short segments.
    """

    sensors: np.ndarray
    commands: np.ndarray
    per_length: np.ndarray
    short: list[tuple[np.ndarray, ...]]


class Memory(NamedTuple):
    """Arrays that a step of one replay writes into; `[N, L]`, or `[N, L − 1]` if of segments."""

    x: np.ndarray
    tail: np.ndarray
    negative: np.ndarray
    mean: np.ndarray
    between: np.ndarray


def records_of(sensors: np.ndarray, commands: np.ndarray, params: Params) -> Records:
    """Prepare records for the step.

    Args:
        sensors: `[N, L, n_s]`.
        commands: `[N, L, n_u]`.
        params: σ decides which segments are short.
    """
    zeta = np.ascontiguousarray(np.moveaxis(sensors, -1, 0))
    length = np.abs(np.diff(zeta))
    is_short = length < SHORT * params.sigma[:, None, None]
    with np.errstate(divide="ignore"):
        per_length = np.where(is_short, 0, 1 / length)
    v = np.ascontiguousarray(np.moveaxis(commands, -1, 0))
    return Records(zeta, v, per_length, [np.nonzero(of_sensor) for of_sensor in is_short])


def memory_for(records: Records) -> Memory:
    """Allocate what a step writes into."""
    samples, segments = records.sensors.shape[1:], records.per_length.shape[1:]
    return Memory(
        x=np.empty(samples),
        tail=np.empty(samples),
        negative=np.empty(samples, bool),
        mean=np.empty(segments),
        between=np.empty(segments, bool),
    )


def segment_mean(records: Records, params: Params, z: float, k: int, memory: Memory) -> np.ndarray:
    """Compute twice the mean of N(z − t; 0, σ²) along each segment of sensor k, `[N, L − 1]`.

        (erfc(x_j) − erfc(x_{j+1})) / (ζ_{j+1} − ζ_j),   x = (ζ − z) / (√2 σ)

    Both tails are taken on one side of the bell, unless z lies between the ends.
    """
    x, tail, mean, between = memory.x, memory.tail, memory.mean, memory.between
    sigma = params.sigma[k]
    np.subtract(records.sensors[k], z, out=x)
    np.multiply(x, 1 / (sigma * np.sqrt(2)), out=x)
    negative = np.less(x, 0, out=memory.negative)
    np.not_equal(negative[:, 1:], negative[:, :-1], out=between)
    np.copysign(erfc(np.abs(x, out=tail), out=tail), x, out=tail)
    np.subtract(tail[:, 1:], tail[:, :-1], out=mean)
    np.abs(mean, out=mean)
    np.subtract(2, mean, out=mean, where=between)
    np.multiply(mean, records.per_length[k], out=mean)
    if len(records.short[k][0]):
        i, j = records.short[k]
        middle = (x[i, j] + x[i, j + 1]) / 2
        mean[i, j] = np.exp(-(middle**2)) * np.sqrt(2 / np.pi) / sigma
    return mean


def likelihood(
    records: Records, params: Params, z: np.ndarray, out: np.ndarray, memory: Memory
) -> np.ndarray:
    """Compute equation 2, p(Z_t | I_t = i, τ_t = j), times 4^n_s, into `out` `[N, L]`.

        ∏_k [2 mean of N over ζ_{j−1} … ζ_j  +  2 mean of N over ζ_j … ζ_{j+1}]_k

    The factor is the same for all states; :func:`update` takes it out of the evidence.
    """
    for k, z_k in enumerate(z):
        mean = segment_mean(records, params, z_k, k, memory)
        both = memory.tail if k else out
        np.add(mean[:, 1:], mean[:, :-1], out=both[:, 1:-1])
        np.multiply(mean[:, [0, -1]], 2, out=both[:, :: both.shape[1] - 1])
        if k:
            np.multiply(out, both, out=out)
    return out


def record_transition(params: Params, mass: np.ndarray) -> np.ndarray:
    """Apply equation 3, p(I_t | I_{t−1}), to the mass `[N, …]` of the records, in place."""
    share = params.theta_i / (len(mass) - 1)
    everywhere = share * mass.sum(axis=0)
    mass *= 1 - params.theta_i - share
    mass += everywhere
    return mass


def time_transition(params: Params, mass: np.ndarray, out: np.ndarray, memory: Memory):
    """Apply equation 4, p(τ_t | τ_{t−1}), to the mass `[N, L]` within each record, into `out`."""
    theta_tau = params.theta_tau
    np.multiply(mass, theta_tau, out=out)
    for step, probability in ((1, 1 - 2 * theta_tau), (2, theta_tau)):
        out[:, step:] += np.multiply(mass, probability, out=memory.x)[:, :-step]
    out[:, -1] += (1 - theta_tau) * mass[:, -1] + theta_tau * mass[:, -2]
    return out


def predict_same_tau(
    params: Params, belief: np.ndarray, out: np.ndarray, memory: Memory
) -> np.ndarray:
    """Compute equation 6 as printed, into `out`: a jump keeps τ.

    In records of one length no probability lands past an end, so there is nothing to renormalise.
    """
    return record_transition(params, time_transition(params, belief, out, memory))


def predict_own_tau(
    params: Params, belief: np.ndarray, out: np.ndarray, memory: Memory
) -> np.ndarray:
    """Compute equation 6 with a distribution over τ of each record's own, into `out`."""
    moved = time_transition(params, belief, out, memory)
    weight = moved.sum(axis=1, keepdims=True)
    after = record_transition(params, weight.copy())
    moved *= np.divide(after, weight, out=np.zeros_like(weight), where=weight > 0)
    return moved


PREDICTIONS = {"same_tau": predict_same_tau, "own_tau": predict_own_tau}


def predict(
    params: Params, belief: np.ndarray, jump: str, out: np.ndarray, memory: Memory
) -> np.ndarray:
    """Compute equation 6 in the reading named by `jump`, into `out`."""
    return PREDICTIONS[jump](params, belief, out, memory)


def command(records: Records, belief: np.ndarray) -> np.ndarray:
    """Compute equation 8, the expected command Σ_{i,j} v_j^i p(i, j): `[n_u]`."""
    return np.einsum("unl,nl->u", records.commands, belief)


def update(
    records: Records,
    params: Params,
    belief: np.ndarray,
    z: np.ndarray,
    spare: np.ndarray,
    memory: Memory,
) -> tuple[np.ndarray, float]:
    """Compute equation 9, in place: p(I, τ | Z_{1:t}) ∝ p(Z_t | I, τ) p(I, τ | Z_{1:t−1}).

    `spare` `[N, L]` is overwritten with the likelihood.

    Returns:
        The belief, and the log evidence log p(Z_t | Z_{1:t−1}).
    """
    belief *= likelihood(records, params, z, spare, memory)
    evidence = belief.sum()
    belief /= evidence
    return belief, np.log(evidence) - len(z) * np.log(4)


def end_probability(belief: np.ndarray) -> float:
    """Return p(τ in the last 10 time steps) of § 2.2.5."""
    return belief[:, -LAST_STEPS:].sum()
