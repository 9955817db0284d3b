"""The accuracy that windows cost: a replay filtered again with all samples stored, and compared."""

from typing import NamedTuple

import jax
import numpy as np

from jaxreplay.filter.belief import Belief
from jaxreplay.filter.options import Options
from jaxreplay.loop.tracker import LANES, Tracker
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.records.columns import command_range


class Audit(NamedTuple):
    """The largest differences over a replay between windows and the complete belief.

    Attributes:
        total_variation: of the predicted beliefs p and q, ½ Σ |p − q|.
        command: of a command, as a share of its range in the records.
    """

    total_variation: float
    command: float


def audit(records: Records, params: Params, options: Options, observations: np.ndarray) -> Audit:
    """Return the largest differences that windows make over one replay's observations.

    Args:
        records: N records.
        params: one set of parameters.
        options: those of the replay.
        observations: `[T, n_s]` Z_1 … Z_T of a replay, in the sensors' units.
    """
    # As many lanes as a study has, all but one idle, so that the same compiled programs serve.
    batch = jax.tree.map(lambda x: np.stack([x] * LANES), params)
    windowed, complete = (Tracker(records, batch, options, windows) for windows in (None, ()))
    span = np.ptp(command_range(records.commands, records.lengths), axis=0)
    span[span == 0] = 1
    first, worst = np.arange(LANES) == 0, np.zeros(2)
    for z in observations:
        for tracker in (windowed, complete):
            tracker.observe(np.stack([z] * LANES), first)
        p, q = (_probabilities(records, tracker.belief(0)) for tracker in (windowed, complete))
        off = np.abs(windowed.command[0] - complete.command[0]) / span
        worst = np.maximum(worst, (np.abs(p - q).sum() / 2, off.max()))
    return Audit(*worst.tolist())


def _probabilities(records: Records, belief: Belief) -> np.ndarray:
    """Return probabilities `[N, L]`, in NumPy, so that nothing is compiled for each width."""
    belief = jax.tree.map(np.asarray, belief)
    stored = np.ldexp(belief.p.mantissa, belief.p.exponent)
    p = np.zeros((records.n_records, records.longest))
    columns = np.broadcast_to(belief.start, len(p))[:, None] + np.arange(stored.shape[1])
    np.put_along_axis(p, columns, stored, axis=1)
    return p
