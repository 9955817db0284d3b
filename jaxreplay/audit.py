"""What windows cost in accuracy: a replay filtered again, all moments held, and compared."""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.filter import Belief, Filter, build_filter
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.tracker import Tracker


class Audit(NamedTuple):
    """The largest differences in a replay, between windows and the whole belief.

    Attributes:
        total_variation: of the predicted beliefs, ½ Σ |p − q|.
        command: of a command, as a share of its range in the records.
    """

    total_variation: float
    command: float


def audit(records: Records, params: Params, jump: str, observations: np.ndarray) -> Audit:
    """Filter observations `[T, n_s]` both ways, step by step.

    Args:
        records: N records.
        params: one set of parameters.
        jump: `"same_tau"` or `"own_tau"`.
        observations: what a replay saw.
    """
    tracker = Tracker(records, jax.tree.map(lambda x: x[None], params), jump)
    filter, compare = build_filter(jump), _compare(jump)
    whole = filter.predict(records, params, filter.init(records))
    going, worst = np.array([True]), np.zeros(2)
    for z in observations:
        tracker.advance(z[None], going)
        whole, _ = filter.update(records, params, whole, z)
        whole = filter.predict(records, params, whole)
        here = compare(records, whole, tracker.belief(0), tracker.command[0])
        worst = np.maximum(worst, np.asarray(here))
    return Audit(*worst.tolist())


@cache
def _compare(jump: str):
    filter: Filter = build_filter(jump)

    @jax.jit
    def compare(records: Records, whole: Belief, held: Belief, command: jax.Array) -> jax.Array:
        p, q = (filter.posterior(records, belief) for belief in (whole, held))
        rows = jnp.arange(records.longest) < records.lengths[:, None]
        low, high = (
            bound(jnp.where(rows, records.commands, -sign * np.inf), axis=(1, 2))
            for bound, sign in ((jnp.min, -1), (jnp.max, 1))
        )
        span = jnp.where(high > low, high - low, 1.0)
        off = jnp.abs(command - filter.command(records, whole)) / span
        return jnp.stack([jnp.abs(p - q).sum() / 2, off.max()])

    return compare
