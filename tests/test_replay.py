from dataclasses import replace

import numpy as np
import pytest

import jaxreplay.tracker as module
from jaxreplay import Params, build_filter, reference
from jaxreplay.plane.demonstrator import DEMONSTRATED, TESTED, facing, record
from jaxreplay.plane.params import SENSOR_RANGES, PlaneParams
from jaxreplay.plane.world import Plane
from jaxreplay.replay import OUTCOMES, replay

LONG = PlaneParams()
SHORT = replace(LONG, time_limit=12.0)


@pytest.fixture(scope="module")
def records():
    return record(PlaneParams(), DEMONSTRATED, 3)[0]


def params(n, theta_i=0.1):
    sigma = np.tile(0.1 * np.array(SENSOR_RANGES), (n, 1))
    return Params(theta_i=np.full(n, theta_i), theta_tau=np.full(n, 0.05), sigma=sigma)


def plane(positions, constants=LONG):
    keys = [(9, b) for b in range(len(positions))]
    return Plane(constants, facing(positions), keys)


class Recorder(Plane):
    """A plane that remembers what was sent and seen."""

    def __init__(self, *args):
        super().__init__(*args)
        self.sent, self.seen = [], []

    def step(self, commands, active):
        self.sent.append(commands.copy())
        self.seen.append(super().step(commands, active))
        return self.seen[-1]


@pytest.mark.parametrize("jump", ["same_tau", "own_tau"])
def test_the_loop_is_predict_command_act_observe_update(records, jump):
    """Every command sent is the reference's, fed what was seen before it; so is the evidence."""
    watched = Recorder(SHORT, facing(TESTED[:1]), [(9, 0)])
    result = replay(records, params(1), watched, jump)
    sensors, commands = ([a.astype(float) for a in x] for x in records.sequences())
    p = params(1)
    theta_i, theta_tau = float(p.theta_i[0]), float(p.theta_tau[0])
    sigma = np.asarray(p.sigma[0], float)
    belief, evidence = reference.initial(sensors), 0.0
    for sent, seen in zip(watched.sent, watched.seen, strict=True):
        belief = reference.predict(sensors, theta_i, theta_tau, belief, jump)
        np.testing.assert_allclose(sent[0], reference.command(commands, belief), atol=2e-5)
        z = seen[0].astype(np.float32).astype(float)
        belief, gained = reference.update(sensors, sigma, belief, z)
        evidence += gained
    assert result.log_evidence[0] == pytest.approx(evidence, rel=1e-5)
    assert result.outcome[0] == "Fs"
    assert result.duration[0] == pytest.approx(12.0)


@pytest.mark.parametrize("jump", ["same_tau", "own_tau"])
def test_windows_drive_as_the_whole_belief_does(records, jump, monkeypatch):
    narrow = replay(records, params(1), plane(TESTED[1:2], SHORT), jump)
    monkeypatch.setattr(module, "WINDOWS", (None,))
    whole = replay(records, params(1), plane(TESTED[1:2], SHORT), jump)
    assert narrow.log_evidence == pytest.approx(whole.log_evidence, rel=1e-5)


def test_a_step_that_drops_too_much_is_done_again_wider(records, monkeypatch):
    monkeypatch.setattr(module, "WINDOWS", (32, 64, None))
    result = replay(records, params(1), plane(TESTED[1:2], SHORT), "same_tau")
    monkeypatch.setattr(module, "WINDOWS", (None,))
    whole = replay(records, params(1), plane(TESTED[1:2], SHORT), "same_tau")
    assert result.widened > 0
    assert whole.widened == 0
    assert result.log_evidence == pytest.approx(whole.log_evidence, rel=1e-5)


def test_a_tracker_goes_on_with_a_wider_window_and_comes_back(records):
    tracker = module.Tracker(records, params(1), "own_tau")
    seen = build_filter("own_tau", None)
    belief = seen.init(records)
    one = Params(theta_i=0.1, theta_tau=0.05, sigma=0.1 * np.array(SENSOR_RANGES))
    sensors, _ = records.sequences()
    on = np.array([True])
    for t in range(40):
        tracker.advance(sensors[0][t : t + 1], on)
        if t == 20:
            tracker.resize(128)
            assert tracker.window == 128
        belief, _ = seen.update(records, one, seen.predict(records, one, belief), sensors[0][t])
    np.testing.assert_allclose(
        tracker.command[0],
        seen.command(records, seen.predict(records, one, belief)),
        atol=2e-5,
    )
    assert tracker.window == module.WINDOWS[0]


def test_replays_fetch_the_cube_where_it_was_demonstrated(records):
    at = plane(DEMONSTRATED[[2, 7, 11, 13, 17]])
    result = replay(records, params(5, theta_i=1e-3), at, "own_tau")
    assert np.sum(result.outcome == "S") >= 3
    won = result.outcome == "S"
    assert (result.alignment_error[won] < 1e3 * PlaneParams().magnet_offset).all()
    assert np.isnan(result.alignment_error[~won]).all()
    np.testing.assert_array_equal(at.lifted[won], True)
    assert (result.duration[won] < PlaneParams().time_limit).all()


def test_outcomes_name_what_happened(records):
    """With records cut before the grasp the replay ends without the cube; backwards it leaves."""
    sensors, commands = records.sequences()
    cut = type(records).from_sequences([s[:100] for s in sensors], [c[:100] for c in commands])
    assert replay(cut, params(1), plane(TESTED[:1]), "own_tau").outcome[0] == "Fg"
    away = [np.full_like(c, -30) for c in commands]
    backwards = type(records).from_sequences(sensors, away)
    assert replay(backwards, params(1), plane(TESTED[:1]), "own_tau").outcome[0] == "Fb"
    assert set(OUTCOMES) == {"S", "Fs", "Fg", "Fb"}


def test_the_same_again_and_no_matter_how_many_beside(records):
    first = replay(records, params(9), plane(TESTED[np.arange(9) % 5], SHORT), "same_tau")
    again = replay(records, params(9), plane(TESTED[np.arange(9) % 5], SHORT), "same_tau")
    alone = replay(records, params(1), plane(TESTED[:1], SHORT), "same_tau")
    np.testing.assert_array_equal(first.log_evidence, again.log_evidence)
    np.testing.assert_array_equal(first.log_evidence[:1], alone.log_evidence)
