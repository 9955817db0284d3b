"""The model written once more, slowly: plain NumPy in float64, for reading and for tests.

It follows the paper's equations term by term, in logarithms so that nothing underflows, and
shares no code with the JAX filter. Sensors and commands are lists of (L_i, n) arrays; a belief
is an (N, max L_i) array of log probabilities, −inf past a record's end.
"""

import numpy as np
from scipy.special import log_ndtr, logsumexp

SHORT = 1e-3  # length × distance, in σ, below which equation 2's integral is a Taylor series


def initial(sensors):
    """Equation 5."""
    belief = np.full((len(sensors), max(map(len, sensors))), -np.inf)
    belief[:, 0] = -np.log(len(sensors))
    return belief


def log_segment_mean(z, start, end, sigma):
    """Log of ∫ N(z − t; 0, σ²) dt / (end − start), t from `start` to `end`; arrays broadcast.

    A segment of no length is the point Gaussian. A short one is its second-order series
    about the midpoint, since the two tails of the integral then cancel.
    """
    a, b = np.minimum(start, end), np.maximum(start, end)
    length, middle = (b - a) / sigma, ((a - z) + (b - z)) / 2 / sigma
    low, high = np.abs(a - z) / sigma, np.abs(b - z) / sigma
    short = length * np.maximum(1, np.maximum(low, high)) < SHORT
    with np.errstate(all="ignore"):
        # log(Φ(far) − Φ(near)), both folded into the left tail unless z lies between them
        inside = (a < z) & (z < b)
        top = np.where(inside, (b - z) / sigma, -np.minimum(low, high))
        bottom = np.where(inside, (a - z) / sigma, -np.maximum(low, high))
        difference = np.log1p(-np.exp(log_ndtr(bottom) - log_ndtr(top)))
        long_mean = log_ndtr(top) + difference - np.log(length)
    point = -(middle**2) / 2 - np.log(2 * np.pi) / 2
    with np.errstate(all="ignore"):
        short_mean = point + np.log1p(length**2 * (middle**2 - 1) / 24)
    return np.where(short, short_mean, long_mean) - np.log(sigma)


def log_observation(z, record, sigma):
    """Equation 2 for all moments of one (L_i, n_s) record: an (L_i,) array.

    A NaN in z is a missing sensor, and contributes nothing.
    """
    total = np.zeros(len(record))
    for k in np.flatnonzero(~np.isnan(z)):
        zeta = record[:, k]
        if len(zeta) == 1:
            total += log_segment_mean(z[k], zeta, zeta, sigma[k])
            continue
        segment = log_segment_mean(z[k], zeta[:-1], zeta[1:], sigma[k])
        total[0] += segment[0]
        total[-1] += segment[-1]
        total[1:-1] += np.log(1 / 2) + np.logaddexp(segment[:-1], segment[1:])
    return total


def record_transition(theta_i, n):
    """Equation 3 as an (N, N) matrix, row I_t, column I_{t−1}."""
    if n == 1:
        return np.ones((1, 1))
    return np.where(np.eye(n, dtype=bool), 1 - theta_i, theta_i / (n - 1))


def time_transition(theta_tau, moments):
    """Equation 4 for the log mass (L_i,) of one record, whose last sample absorbs."""
    last = len(moments) - 1
    moved = np.full(len(moments), -np.inf)
    for step, probability in ((0, theta_tau), (1, 1 - 2 * theta_tau), (2, theta_tau)):
        if probability > 0:
            to = np.minimum(np.arange(len(moments)) + step, last)
            np.logaddexp.at(moved, to, np.log(probability) + moments)
    return moved


def predict(sensors, theta_i, theta_tau, belief, jump="same_tau"):
    """Equation 6, in either reading of a jump."""
    lengths = [len(s) for s in sensors]
    n = len(lengths)
    with np.errstate(divide="ignore"):
        transition = np.log(record_transition(theta_i, n))
    moved = np.full_like(belief, -np.inf)
    for i, length in enumerate(lengths):
        moved[i, :length] = time_transition(theta_tau, belief[i, :length])

    predicted = np.full_like(belief, -np.inf)
    if jump == "own_tau":
        weight = logsumexp(belief, axis=1)
        for i, length in enumerate(lengths):
            new_weight = logsumexp(transition[i] + weight)
            predicted[i, :length] = new_weight + moved[i, :length] - weight[i]
        return predicted
    for i, length in enumerate(lengths):
        predicted[i, :length] = logsumexp(transition[i][:, None] + moved[:, :length], axis=0)
    remaining = logsumexp(predicted)
    return predicted - remaining if remaining > -np.inf else belief


def command(commands, belief):
    """Equation 8."""
    return sum(np.exp(belief[i, : len(v)]) @ v for i, v in enumerate(commands))


def update(sensors, sigma, belief, z):
    """Equation 9: the new belief, and log p(Z_t | Z_{1:t−1})."""
    joint = np.full_like(belief, -np.inf)
    for i, record in enumerate(sensors):
        joint[i, : len(record)] = belief[i, : len(record)] + log_observation(z, record, sigma)
    best = joint.max()  # subtracted first: far from every record it dwarfs what decides
    log_sum = logsumexp(joint - best)
    return (joint - best) - log_sum, best + log_sum


def end_probability(sensors, belief):
    """§ 2.2.5: the probability of the last 10 moments of each record."""
    ends = [np.exp(belief[i, max(0, len(s) - 10) : len(s)]).sum() for i, s in enumerate(sensors)]
    return sum(ends)
