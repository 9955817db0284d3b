"""A window that travels with the belief: what it stores suffices, what it drops is reported."""

import numpy as np
from filter_helpers import noise, own_tau_first, run
from random_helpers import N_SENSORS

from jaxreplay import Params, build_filter
from jaxreplay.filter.belief import NOTHING_DROPPED

SIGMA = np.array([0.5, 2.0])


def long_records(lengths=(200, 190, 200, 196)):
    """Variations of one slope, σ / 5 a sample, and observations passing one of them."""
    slope = 0.2 * SIGMA * np.arange(200)[:, None]
    sensors = [slope[:n] + SIGMA * noise(i, n, N_SENSORS) for i, n in enumerate(lengths)]
    commands = [noise(i, n, 2) for i, n in enumerate(lengths)]
    at = np.clip(np.cumsum(np.random.default_rng(0).choice([0, 1, 1, 1, 2], 210)), 0, 199)
    return (sensors, commands), sensors[2][at] + SIGMA * noise(9, len(at), N_SENSORS)


@own_tau_first
def test_window_stores_all_that_matters(jump):
    sequences, zs = long_records()
    params = Params(0.1, 0.05, SIGMA)
    dense, _ = run(build_filter(jump), sequences, zs, params)
    windowed, belief = run(build_filter(jump, window=32), sequences, zs, params)
    assert belief.p.mantissa.shape == (4, 32)
    highest = -30 if jump == "same_tau" else 0  # under own_tau relative to each record's own
    assert NOTHING_DROPPED < belief.dropped < highest
    assert np.min(belief.start) > 150
    for a, b in zip(windowed[:2] + windowed[3:], dense[:2] + dense[3:], strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    np.testing.assert_allclose(windowed[2], dense[2], rtol=1e-5)


@own_tau_first
def test_window_reports_what_it_dropped(jump):
    (sensors, commands), zs = long_records()
    flat = [np.zeros_like(s) for s in sensors]
    params = Params(0.1, 0.5, SIGMA)
    f = build_filter(jump, window=32)
    _, early = run(f, (flat, commands), 0 * zs[:14], params)
    assert early.dropped == NOTHING_DROPPED  # after t steps τ is at most 2 t
    (posterior, *_), late = run(f, (flat, commands), 0 * zs[:150], params)
    assert -30 < late.dropped <= 0
    np.testing.assert_allclose(posterior.sum((1, 2)), 1, atol=1e-5)
