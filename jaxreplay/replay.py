"""The closed loop: the filter drives the plane. The only room where both meet."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np

from jaxreplay.params import Params
from jaxreplay.plane.world import Plane
from jaxreplay.records import Records
from jaxreplay.tracker import Tracker

COMPLETED = 0.9  # § 2.2.5
CHUNK = 7  # replays that advance in one call of the filter
OUTCOMES = ("S", "Fs", "Fg", "Fb")  # as in figure 3


class Replays(NamedTuple):
    """What B replays came to.

    Attributes:
        outcome: `[B]` S (cube held and lifted when the replay ended), Fs (not ended within the
            time limit), Fg (ended without the cube) or Fb (left the area).
        alignment_error: `[B]` lateral distance between the magnet's centre and the centre of
            the face it took hold of, mm; NaN unless S.
        duration: `[B]` s.
        log_evidence: `[B]` log p(Z_1:t) of the whole replay.
        widened: how often a step was done again in a wider window.
    """

    outcome: np.ndarray
    alignment_error: np.ndarray
    duration: np.ndarray
    log_evidence: np.ndarray
    widened: int


def replay(
    records: Records,
    params: Params,
    plane: Plane,
    jump: str,
    progress: Callable[[int, np.ndarray], None] = lambda step, outcome: None,
) -> Replays:
    """Replay the records in every world of a plane, all advancing together.

    Args:
        records: demonstrations of the plane's 7 sensors and 5 commands.
        params: `[B]`-batched parameters.
        plane: B fresh worlds.
        jump: `"same_tau"` or `"own_tau"`.
        progress: called after every control step with its number and the outcomes so far
            (empty strings for replays that go on).
    """
    p, n = plane.params, len(plane.state.robot)
    outcome = np.full(n, "", dtype="<U2")
    duration = np.full(n, np.nan)
    # Chunks of one size, so that one program serves all; the last is filled up with replays that
    # never go on.
    parts = [slice(i, i + CHUNK) for i in range(0, n, CHUNK)]
    m = parts[-1].stop
    going = np.zeros(m, dtype=bool)
    z = np.zeros((m, records.n_sensors))
    log_evidence, ended = np.zeros(m), np.zeros(m)
    lanes = jax.tree.map(lambda x: x[np.minimum(np.arange(m), n - 1)], params)
    chunks = [Tracker(records, jax.tree.map(lambda x, s=s: x[s], lanes), jump) for s in parts]

    def advance(chunk: Tracker, part: slice):
        if going[part].any():
            gained, ended[part] = chunk.advance(z[part], going[part])
            log_evidence[part] += gained

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for step in range(1, p.max_steps + 1):
            going[:n] = outcome == ""
            commands = np.concatenate([chunk.command for chunk in chunks])[:n]
            z[:n] = plane.step(commands, going[:n])
            list(threads.map(advance, chunks, parts))

            completed = ended[:n] > COMPLETED
            for name, is_so in (
                ("Fb", plane.outside),
                ("S", completed & plane.lifted),
                ("Fg", completed),
                ("Fs", np.full(n, step == p.max_steps)),
            ):
                outcome[(outcome == "") & is_so] = name
            duration[going[:n]] = step * p.control_period
            progress(step, outcome)
            if (outcome != "").all():
                break
    error = np.where(outcome == "S", 1e3 * plane.alignment_error, np.nan)
    widened = sum(chunk.widened for chunk in chunks)
    return Replays(outcome, error, duration, log_evidence[:n], widened)
