"""The model in plain NumPy and float64: read this file first, beside section 2 of the paper.

Most functions are one equation each. They have the names of their JAX counterparts in
:mod:`jaxreplay.filter`, which take `Records` for the lists, and divide equation 2 by
N(Z_t; anchor, σ²), where the anchor is one point near the observation. The two share no code, and
tests hold both to the paper.
Everything is computed in logarithms, so that no probability underflows.

- `sensors` and `commands` are lists of N arrays, (L_i, n_s) and (L_i, n_u): the records Π (§ 2.1).
  Row t of a record is the command v_t and the observation ζ_t made after it. Records and samples
  are counted from 0, as equation 5 does (§ 2.1 counts them from 1).
- a `belief` is an (N, L) array of log p(I = i, τ = j), L = max L_i, with −∞ past a record's end.
- `z` is an (n_s,) observation Z_t; NaN marks a missing sensor. NaN in a record marks a sample that
  was not measured.

The paper leaves some points open. They are decided here, each where it arises:

- **Equation 2.** N(t, σ²) is read as the normal density of Z_t − t. The first and the last sample
  of a record touch only one segment, which carries full weight. A segment of length zero is the
  point Gaussian, its limit; so is a record of one sample.
- **A sample that was not measured** is taken to lie on the straight line between the measured ones
  beside it, as equation 2 takes all that lies between two samples; before the first and after the
  last measured one, at that one (`filled`). So a state keeps all factors of the product, and states
  with and without a measurement stay comparable.
- **Equation 3** with one record is the identity: there is no other record to jump to.
- **Equations 4 and 6.** The step along τ is taken in the record that is departed from; its last
  sample absorbs what would pass it. Then comes the jump. Where a jump keeps τ (`same_tau`, below),
  probability that lands past the end of its new record is discarded, and the rest is renormalised;
  if nothing remains (θ_I = 1, and all probability is past the end of every other record), the
  belief before the step is kept.
- **Equation 5** places all probability on each record's first sample, before the first prediction.
  The first command is therefore mostly that of the second row.
- **Section 2.2.5.** "The last 10 time steps" are those of each record; a shorter record counts
  whole.
- **Two readings of a jump,** that is, interpretations of equation 6. `same_tau` is the equation as
  printed: a jump keeps τ, so it lands at the same index of the new record. In `own_tau`, the
  reading of the authors' later software, every record keeps its own distribution over τ, and a jump
  lands where that of the new record is. This is an approximation: it is not the exact filter of
  equation 1, and τ may decrease across a jump.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, logsumexp

Sequences = Sequence[np.ndarray]  # N arrays (L_i, n)

LAST_STEPS = 10  # § 2.2.5
# A segment is short, and its mean is computed as a series, where d · max(1, u) is below this: d is
# its length and u the distance from z to its farther end, both in σ.
SHORT = 1e-3


class Params(NamedTuple):
    """The n_s + 2 parameters (§ 2.2.1).

    Attributes:
        theta_i: θ_I, the probability to jump to another record.
        theta_tau: θ_τ, the probability to stay at a sample, and that to skip one.
        sigma: (n_s,) σ of each sensor, in its unit.
    """

    theta_i: float
    theta_tau: float
    sigma: np.ndarray


def segment_mean(z: ArrayLike, start: ArrayLike, end: ArrayLike, sigma: float) -> np.ndarray:
    """Compute the logarithm of the mean of N(z − t; 0, σ²) for t from `start` to `end`.

        1 / (end − start) · ∫ N(z − t; 0, σ²) dt,   one integral of equation 2

    The integral is a difference of two tails, Φ((end − z) / σ) − Φ((start − z) / σ). Both
    arguments are mirrored to be negative, where log Φ is accurate, unless z lies between the ends.
    On a short segment the tails cancel, and the second-order series about the midpoint m is used:
    N(z − m) · (1 + d² (x² − 1) / 24), with d = (end − start) / σ and x = (m − z) / σ.

    Args:
        z: observations of one sensor; arrays broadcast against each other.
        start: where segments start.
        end: where they end.
        sigma: σ of the sensor.

    Returns:
        The logarithms, in the shape that the arrays broadcast to.
    """
    z, start, end = (np.asarray(value, float) for value in (z, start, end))
    a, b = np.minimum(start, end), np.maximum(start, end)
    length, middle = (b - a) / sigma, ((a - z) + (b - z)) / 2 / sigma
    low, high = np.abs(a - z) / sigma, np.abs(b - z) / sigma
    short = length * np.maximum(1, np.maximum(low, high)) < SHORT
    with np.errstate(all="ignore"):
        between = (a < z) & (z < b)
        top = np.where(between, (b - z) / sigma, -np.minimum(low, high))
        bottom = np.where(between, (a - z) / sigma, -np.maximum(low, high))
        difference = np.log1p(-np.exp(log_ndtr(bottom) - log_ndtr(top)))
        long_mean = log_ndtr(top) + difference - np.log(length)
    point = -(middle**2) / 2 - np.log(2 * np.pi) / 2
    with np.errstate(all="ignore"):
        short_mean = point + np.log1p(length**2 * (middle**2 - 1) / 24)
    return np.where(short, short_mean, long_mean) - np.log(sigma)


def filled(record: np.ndarray) -> np.ndarray:
    """Return a record (L, n_s) with straight lines in the place of samples not measured (NaN).

    Each sensor needs at least one measured sample.
    """
    rows, measured = np.arange(len(record)), ~np.isnan(record)
    columns = [
        np.interp(rows, rows[there], values[there])
        for values, there in zip(record.T, measured.T, strict=True)
    ]
    return np.column_stack(columns)


def likelihood(sensors: Sequences, params: Params, z: np.ndarray) -> np.ndarray:
    """Compute equation 2: log p(Z_t | I_t = i, τ_t = j) for all i and j, an (N, L) array.

        ∏_k ½ [mean of N over ζ_{j−1} … ζ_j  +  mean of N over ζ_j … ζ_{j+1}]_k

    A missing sensor (NaN) contributes no factor. Entries past a record's end are −∞.
    """
    sensors = [filled(record) for record in sensors]
    logs = np.full(_shape(sensors), -np.inf)
    for i, record in enumerate(sensors):
        logs[i, : len(record)] = 0.0
        for k in np.flatnonzero(~np.isnan(z)):
            zeta, sigma = record[:, k], params.sigma[k]
            if len(zeta) == 1:
                logs[i, 0] += segment_mean(z[k], zeta, zeta, sigma)[0]
                continue
            segment = segment_mean(z[k], zeta[:-1], zeta[1:], sigma)
            halves = np.log(1 / 2) + np.logaddexp(segment[:-1], segment[1:])
            logs[i, : len(record)] += np.concatenate([segment[:1], halves, segment[-1:]])
    return logs


def record_transition(params: Params, mass: np.ndarray) -> np.ndarray:
    """Apply equation 3, p(I_t | I_{t−1}), to the log mass (N, …) of the records.

    p(I_t = i | I_{t−1} = i') = 1 − θ_I if i = i', else θ_I / (N − 1)
    """
    n = len(mass)
    if n == 1:
        return mass
    matrix = np.full((n, n), params.theta_i / (n - 1))
    np.fill_diagonal(matrix, 1 - params.theta_i)
    with np.errstate(divide="ignore"):
        weighted = np.log(matrix).reshape(n, n, *[1] * (mass.ndim - 1)) + mass
    return _log_sum(weighted, axis=1)


def time_transition(sensors: Sequences, params: Params, mass: np.ndarray) -> np.ndarray:
    """Apply equation 4, p(τ_t | τ_{t−1}), to the log mass (N, L) within each record.

    p(+0) = θ_τ, p(+1) = 1 − 2 θ_τ, p(+2) = θ_τ; the last sample absorbs what would pass it.
    """
    theta_tau = params.theta_tau
    moved = np.full(mass.shape, -np.inf)
    for i, record in enumerate(sensors):
        here = np.arange(len(record))
        for step, probability in ((0, theta_tau), (1, 1 - 2 * theta_tau), (2, theta_tau)):
            if probability > 0:
                to = np.minimum(here + step, len(record) - 1)
                np.logaddexp.at(moved[i], to, np.log(probability) + mass[i, here])
    return moved


def init(sensors: Sequences, start: str = "first") -> np.ndarray:
    """Return the belief of equation 5: p = 1/N at each record's first sample, else 0.

    A robot that may be anywhere (`start="anywhere"`) starts with p = 1 / (N L_i) at each sample of
    record i instead.
    """
    belief = np.full(_shape(sensors), -np.inf)
    for i, record in enumerate(sensors):
        samples = {"first": 1, "anywhere": len(record)}[start]
        belief[i, :samples] = -np.log(len(sensors) * samples)
    return belief


def predict_same_tau(sensors: Sequences, params: Params, belief: np.ndarray) -> np.ndarray:
    """Compute equation 6 as printed: a jump keeps τ, and lands at that index of the new record.

    p(I_t, τ_t | Z_{1:t−1}) = Σ_I' p(I_t | I') Σ_τ' p(τ_t | τ') p(I', τ' | Z_{1:t−1})
    """
    landed = record_transition(params, time_transition(sensors, params, belief))
    for i, record in enumerate(sensors):
        landed[i, len(record) :] = -np.inf
    remaining = float(_log_sum(landed))
    return landed - remaining if remaining > -np.inf else belief


def predict_own_tau(sensors: Sequences, params: Params, belief: np.ndarray) -> np.ndarray:
    """Compute equation 6 with a distribution over τ that each record keeps for itself.

    p(I_t = i, τ_t) = [Σ_I' p(I_t = i | I') p(I')] · [Σ_τ' p(τ_t | τ') p(τ' | I_{t−1} = i)]
    """
    weight = _log_sum(belief, axis=1)[:, None]
    moved = time_transition(sensors, params, belief)
    return record_transition(params, weight) + moved - weight


def predict(
    sensors: Sequences, params: Params, belief: np.ndarray, jump: str = "own_tau"
) -> np.ndarray:
    """Compute equation 6 in the reading named by `jump`: `"same_tau"` or `"own_tau"`."""
    readings = {"same_tau": predict_same_tau, "own_tau": predict_own_tau}
    return readings[jump](sensors, params, belief)


def command(commands: Sequences, belief: np.ndarray) -> np.ndarray:
    """Compute equation 8 (with 7): the expected command Σ_{i,j} v_j^i p(i, j), an (n_u,) array."""
    return np.sum([np.exp(belief[i, : len(v)]) @ v for i, v in enumerate(commands)], axis=0)


def update(
    sensors: Sequences, params: Params, belief: np.ndarray, z: np.ndarray
) -> tuple[np.ndarray, float]:
    """Compute equation 9: p(I, τ | Z_{1:t}) ∝ p(Z_t | I, τ) p(I, τ | Z_{1:t−1}).

    Returns:
        The belief, and the logarithm of the normalising sum, log p(Z_t | Z_{1:t−1}).
    """
    joint = belief + likelihood(sensors, params, z)
    # Subtracted first: far from all records `best` is so negative that adding `log_sum` would round
    # the differences away.
    best = joint.max()
    log_sum = float(_log_sum(joint - best))
    return (joint - best) - log_sum, float(best + log_sum)


def end_probability(sensors: Sequences, belief: np.ndarray, last_steps: int = LAST_STEPS) -> float:
    """Return p(τ in the last 10 time steps) of § 2.2.5; above 0.9 the task is complete."""
    ends = [
        np.exp(belief[i, max(0, len(record) - last_steps) : len(record)]).sum()
        for i, record in enumerate(sensors)
    ]
    return float(sum(ends))


def _log_sum(logs: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return log Σ exp(logs)."""
    return np.asarray(logsumexp(logs, axis=axis))


def _shape(sensors: Sequences) -> tuple[int, int]:
    return len(sensors), max(map(len, sensors))
