"""What windows cost in accuracy: a replay filtered again, all moments held, and compared."""

from typing import NamedTuple

import jax
import numpy as np

from jaxreplay.filter import Belief
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.tracker import LANES, Tracker


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
    # As many lanes as a study has, all but one at rest, for the same compiled programs to serve.
    batch = jax.tree.map(lambda x: np.stack([x] * LANES), params)
    tracker, dense = Tracker(records, batch, jump), Tracker(records, batch, jump, windows=())
    commands = np.concatenate(records.sequences()[1])
    span = np.ptp(commands, axis=0)
    span[span == 0] = 1
    first, worst = np.arange(LANES) == 0, np.zeros(2)
    for z in observations:
        for each in (tracker, dense):
            each.advance(np.stack([z] * LANES), first)
        p, q = (_posterior(records, each.belief(0)) for each in (tracker, dense))
        off = np.abs(tracker.command[0] - dense.command[0]) / span
        worst = np.maximum(worst, (np.abs(p - q).sum() / 2, off.max()))
    return Audit(*worst.tolist())


def _posterior(records: Records, belief: Belief) -> np.ndarray:
    """Probabilities `[N, L]`."""
    belief = jax.tree.map(np.asarray, belief)
    held = np.ldexp(belief.p.mantissa, belief.p.exponent)
    p = np.zeros((records.n_records, records.longest))
    columns = np.broadcast_to(belief.start, len(p))[:, None] + np.arange(held.shape[1])
    np.put_along_axis(p, columns, held, axis=1)
    return p
