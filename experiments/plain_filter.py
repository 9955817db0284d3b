"""The filter as one would write it at first: float32 probabilities, and nothing against underflow.

The functions are those of `jaxreplay/reference.py`, by the same names, in JAX and without
logarithms. `causes.py` replays with them, as the controller `"plain_filter:Plain"`, to see what
underflow does to the paper's claims.
"""

from functools import partial, reduce
from operator import mul

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf
from jax.scipy.stats import norm

from jaxreplay import Params, Records
from jaxreplay.filter.options import Options
from jaxreplay.filter.steps import LAST_STEPS
from jaxreplay.loop.controller import FilterController


def segment_mean(nodes: jax.Array, z: jax.Array, sigma: jax.Array) -> jax.Array:
    """Compute the mean of N(z − t; 0, σ²) along each segment between nodes.

        (Φ(x_{j+1}) − Φ(x_j)) / (ζ_{j+1} − ζ_j),   x = (ζ − z) / σ

    A segment of length zero is the point Gaussian.

    Args:
        nodes: `[n_s, N, n]` samples ζ.
        z: `[n_s]` the observation.
        sigma: `[n_s]` σ.

    Returns:
        `[n_s, N, n − 1]`.
    """
    sigma = sigma[:, None, None]
    x = (nodes - z[:, None, None]) / sigma
    # Behind a barrier, as XLA would otherwise compute both again for each segment that they end.
    cdf, point = jax.lax.optimization_barrier(((1 + erf(x / 2**0.5)) / 2, norm.pdf(x)))
    length = jnp.diff(x)
    return jnp.where(length == 0, point[..., 1:], jnp.diff(cdf) / length) / sigma


def likelihood(records: Records, params: Params, z: jax.Array) -> jax.Array:
    """Compute the factors of equation 2, one for each sensor k, `[n_s, N, L]`; z is centred.

        ½ [mean of N over ζ_{j−1} … ζ_j  +  mean of N over ζ_j … ζ_{j+1}]_k

    :func:`update` multiplies the belief by one after the other.
    """
    mean = segment_mean(records.nodes, z, params.sigma)
    return (mean[..., :-1] + mean[..., 1:]) / 2


def record_transition(params: Params, mass: jax.Array) -> jax.Array:
    """Apply equation 3, p(I_t | I_{t−1}), to the mass `[N, …]` of the records."""
    others = mass.sum(axis=0, keepdims=True) - mass
    return (1 - params.theta_i) * mass + params.theta_i / (len(mass) - 1) * others


def time_transition(records: Records, params: Params, mass: jax.Array) -> jax.Array:
    """Apply equation 4, p(τ_t | τ_{t−1}), to the mass `[N, L]` within each record.

    The last sample absorbs what would pass it.
    """
    longest = records.longest
    last = jnp.arange(longest)[None] == records.lengths[:, None] - 1
    stay, step = params.theta_tau, 1 - 2 * params.theta_tau
    one, two = (jnp.pad(mass, ((0, 0), (k, 0)))[:, :longest] for k in (1, 2))
    moved = jnp.where(last, 1, stay) * mass + jnp.where(last, 1 - stay, step) * one + stay * two
    return _inside(records) * moved


def init(records: Records) -> jax.Array:
    """Return the belief `[N, L]` of equation 5: 1/N at each record's first sample, else 0."""
    return jnp.zeros((records.n_records, records.longest)).at[:, 0].set(1 / records.n_records)


def predict_same_tau(records: Records, params: Params, belief: jax.Array) -> jax.Array:
    """Compute equation 6 as printed: a jump keeps τ. Probability past an end is discarded."""
    moved = time_transition(records, params, belief)
    landed = _inside(records) * record_transition(params, moved)
    return landed / landed.sum()


def predict_own_tau(records: Records, params: Params, belief: jax.Array) -> jax.Array:
    """Compute equation 6 with a distribution over τ that each record keeps for itself."""
    weight = belief.sum(axis=1, keepdims=True)
    moved = time_transition(records, params, belief)
    landed = record_transition(params, weight) * jnp.where(weight > 0, moved / weight, 0)
    return landed / landed.sum()


PREDICTIONS = {"same_tau": predict_same_tau, "own_tau": predict_own_tau}


def predict(records: Records, params: Params, belief: jax.Array, jump: str) -> jax.Array:
    """Compute equation 6 in the reading named by `jump`: `"same_tau"` or `"own_tau"`."""
    return PREDICTIONS[jump](records, params, belief)


def command(records: Records, belief: jax.Array) -> jax.Array:
    """Compute equation 8, the expected command Σ_{i,j} v_j^i p(i, j): `[n_u]`."""
    return jnp.einsum("kij,ij->k", records.commands, belief, precision="highest")


def update(
    records: Records, params: Params, belief: jax.Array, z: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute equation 9: p(I, τ | Z_{1:t}) ∝ p(Z_t | I, τ) p(I, τ | Z_{1:t−1}).

    Returns:
        The belief, as it was where no state has any probability left, and the log evidence
        log p(Z_t | Z_{1:t−1}), then −∞.
    """
    joint = reduce(mul, likelihood(records, params, z), belief)
    evidence = joint.sum()
    return jnp.where(evidence > 0, joint / evidence, belief), jnp.log(evidence)


def end_probability(records: Records, belief: jax.Array) -> jax.Array:
    """Return p(τ in the last 10 time steps) of § 2.2.5."""
    at_end = jnp.arange(records.longest)[None] >= records.lengths[:, None] - LAST_STEPS
    return (at_end * belief).sum()


class PlainTracker:
    """Tracks B replays with this filter, as :class:`jaxreplay.loop.tracker.Tracker` does with ours.

    Attributes:
        command: `[B, n_u]` the commands to send next.
        widened: `[B]` 0, as there are no windows.
        dropped: `[B]` −∞, as there are no windows.
    """

    def __init__(self, records: Records, params: Params, options: Options):
        """Begin B replays."""
        n = len(params.theta_i)
        self.records, self.jump = records, options.jump
        self.command = np.zeros((n, records.n_commands))
        self.widened, self.dropped = np.zeros(n, int), np.full(n, -np.inf)
        self.belief = jnp.zeros((n, records.n_records, records.longest))
        self.begin(np.ones(n, bool), params)

    def begin(self, which: np.ndarray, params: Params) -> None:
        """Begin the replays `which` at the records' first samples."""
        self.params = params
        first = jnp.broadcast_to(init(self.records), self.belief.shape)
        begun, command = _predicted(self.records, params, first, self.jump)
        self.belief = jnp.where(which[:, None, None], begun, self.belief)
        self.command[which] = np.asarray(command)[which]

    def observe(self, z: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, ...]:
        """Update beliefs with observations `[B, n_s]`, and predict.

        Returns:
            log p(Z_t | Z_{1:t−1}), p(τ in the last 10 samples), and NaN for a distance, each `[B]`.
        """
        z = self.records.centre(z)
        belief, log_evidence, ended = _updated(self.records, self.params, self.belief, z)
        self.belief, command = _predicted(self.records, self.params, belief, self.jump)
        self.command[which] = np.asarray(command)[which]
        return np.asarray(log_evidence), np.asarray(ended), np.full(len(which), np.nan)


class Plain(FilterController):
    """Controls replays with this filter."""

    def __init__(self, records: Records, params: Params, options: Options):
        """Begin B replays."""
        super().__init__(records, params, options, tracker=PlainTracker)


@partial(jax.jit, static_argnames="jump")
@partial(jax.vmap, in_axes=(None, 0, 0, None))
def _predicted(records: Records, params: Params, belief: jax.Array, jump: str):
    belief = predict(records, params, belief, jump)
    return belief, command(records, belief)


@jax.jit
@partial(jax.vmap, in_axes=(None, 0, 0, 0))
def _updated(records: Records, params: Params, belief: jax.Array, z: jax.Array):
    belief, log_evidence = update(records, params, belief, z)
    return belief, log_evidence, end_probability(records, belief)


def _inside(records: Records) -> jax.Array:
    """Mark the `[N, L]` entries that are moments of a record, not padding."""
    return jnp.arange(records.longest)[None] < records.lengths[:, None]
