import numpy as np
import pytest
from filter_helpers import own_tau_first
from random_helpers import random_sequences

from jaxreplay import Params, Records, reference
from jaxreplay.filter.options import Options
from jaxreplay.loop import tracker
from jaxreplay.loop.audit import audit

THETA_I, THETA_TAU, SIGMA = 0.1, 0.3, [0.5, 0.5]


@pytest.fixture(scope="module")
def setting():
    """Records that say the same for a hundred moments: a belief spreads over them."""
    sensors, commands = random_sequences(1, lengths=(200, 180))
    for s in sensors:
        s[20:150] = s[20]
    seen = np.concatenate([sensors[0][:20], np.tile(sensors[0][20], (100, 1)), sensors[0][150:160]])
    return sensors, commands, seen


@own_tau_first
def test_windows_that_drop_nothing_that_matters_are_found_exact(setting, jump):
    sensors, commands, seen = setting
    records = Records.from_sequences(sensors, commands)
    found = audit(records, Params(THETA_I, THETA_TAU, SIGMA), Options(jump), seen)
    assert found.total_variation < 1e-5
    assert found.command < 1e-5


def test_what_a_narrow_window_loses_is_measured(setting, monkeypatch):
    """Held against the reference, which has none."""
    sensors, commands, seen = setting
    records, params = Records.from_sequences(sensors, commands), Params(THETA_I, THETA_TAU, SIGMA)
    monkeypatch.setattr(tracker, "WINDOWS", (32,))
    monkeypatch.setattr(tracker, "MARGIN", -(2**29))
    found = audit(records, params, Options("own_tau"), seen)

    same = reference.Params(THETA_I, THETA_TAU, np.array(SIGMA))
    narrow = tracker.Tracker(records, Params([THETA_I], [THETA_TAU], [SIGMA]), Options("own_tau"))
    belief, worst = reference.init(sensors), 0.0
    span = np.ptp(np.concatenate(commands), axis=0)
    belief = reference.predict(sensors, same, belief, "own_tau")
    for z in seen:
        narrow.observe(z[None], np.array([True]))
        belief, _ = reference.update(sensors, same, belief, z)
        belief = reference.predict(sensors, same, belief, "own_tau")
        off = np.abs(narrow.command[0] - reference.command(commands, belief)) / span
        worst = max(worst, off.max())
    assert found.command == pytest.approx(worst, rel=1e-3)
    assert found.command > 0.01
    assert 0.01 < found.total_variation <= 1 + 1e-6
