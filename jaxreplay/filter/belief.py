"""The belief p(I_t, τ_t | Z) of one replay.

- A *sample* is a position on a record: τ = j is its sample j, the moment of the record at which the
  replay is.
- A *hypothesis* is a pair (i, j): the robot is at sample j of record i.
- A *reading of a jump* is an interpretation of equation 6: `same_tau` or `own_tau` (see
  :mod:`jaxreplay.filter.transition`).
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import jax

from jaxreplay.filter.numerics.scaled import LOWEST, Scaled

Jump = Literal["same_tau", "own_tau"]
READINGS: tuple[Jump, ...] = ("same_tau", "own_tau")
# The default, as equation 6 as printed loses its place where demonstrations pass the same situation
# at different times: in the simulated robot 1 of 45 runs succeeds with θ_I from 10^-1.5 up, where
# own_tau succeeds in 31 (experiments/theta_i.toml).
DEFAULT_JUMP: Jump = "own_tau"

NOTHING_DROPPED = 2 * LOWEST  # as a log2 probability


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["p", "start", "dropped"],
    meta_fields=["jump", "window"],
)
@dataclass(frozen=True)
class Belief:
    """p(I_t = i, τ_t = j | Z), for the W samples of each record that are stored.

    Attributes:
        p: `[N, W]` probabilities, 0 past a record's end. Each has an exponent of its own (see
            :mod:`jaxreplay.filter.numerics.scaled`), so no hypothesis is lost to underflow.
        start: the first stored sample, int32. One number under `same_tau`, where a jump keeps τ;
            `[N]`, one for each record, under `own_tau`. 0 without a window.
        dropped: log2 of the probability of the most probable hypothesis that a window has
            discarded so far, int32; right to within two bits either way. Under `own_tau` it is
            relative to the most probable sample of the same record. `NOTHING_DROPPED` if nothing
            was discarded.
        jump: the reading of a jump, `"same_tau"` or `"own_tau"`; static.
        window: W, or None where all samples are stored (W = L); static.
    """

    p: Scaled
    start: jax.Array
    dropped: jax.Array
    jump: Jump
    window: int | None
