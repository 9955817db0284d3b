"""Replays stepped one after the other, as on a CPU, or at once, as on an accelerator, agree."""

import jax
import numpy as np
import pytest
from filter_helpers import own_tau_first, passing
from random_helpers import random_sequences

from jaxreplay import Params, Records
from jaxreplay.filter.options import Options
from jaxreplay.loop import lanes
from jaxreplay.loop.tracker import Tracker

SIGMA = np.array([0.5, 2.0])
B = 3


def run(jump, over_lanes, monkeypatch):
    """Commands, log evidence, end probabilities and windows of a run in which a replay restarts."""
    monkeypatch.setattr(lanes, "_each", over_lanes)
    sequences = random_sequences(1, (120, 120, 90, 35))
    records = Records.from_sequences(*sequences)
    params = Params(np.array([0.0, 0.1, 1e-3]), np.full(B, 0.05), np.outer([0.5, 1, 2], SIGMA))
    tracker = Tracker(records, params, Options(jump), windows=(48,))
    zs = [passing(sequences[0][i], SIGMA, 40, seed=i) for i in range(B)]
    seen = []
    for t in range(40):
        which = np.array([True, t % 2 == 0, t != 7])
        seen.append((*tracker.observe(np.stack([z[t] for z in zs]), which), tracker.command.copy()))
        if t == 20:
            tracker.begin(np.array([False, True, False]), params)
    return [np.array(values) for values in zip(*seen, strict=True)], tracker.window


@own_tau_first
def test_one_after_the_other_and_at_once_agree(jump, monkeypatch):
    each, windows = run(jump, lanes._each, monkeypatch)
    together, others = run(jump, lanes._together, monkeypatch)
    for a, b in zip(each, together, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-6)
    np.testing.assert_array_equal(windows, others)


@pytest.mark.parametrize(("backend", "chosen"), [("cpu", "_each"), ("gpu", "_together")])
def test_the_backend_chooses(backend, chosen, monkeypatch):
    seen = []
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    monkeypatch.setattr(lanes, "_steps", lambda *given: seen.append(given))
    lanes.steps("own_tau", 64)
    assert seen == [("own_tau", 64, getattr(lanes, chosen))]
