from dataclasses import replace

import gymnasium
import jax
import numpy as np
import pytest
from filter_helpers import own_tau_first
from gymnasium.vector import AutoresetMode, VectorEnv
from plane_helpers import OLD

from jaxreplay import Params, Records, build_filter, reference
from jaxreplay.filter.options import Options
from jaxreplay.loop import tracker as module
from jaxreplay.loop.replay import replay
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.params import SENSOR_RANGES
from jaxreplay.plane.positions import DEMONSTRATED, TESTED, facing
from jaxreplay.study.demonstrations import record
from jaxreplay.study.worlds.plane import Plane

pytestmark = pytest.mark.usefixtures("fewer_windows")

LONG = OLD
SHORT = replace(LONG, time_limit=12.0)


@pytest.fixture(scope="module")
def records():
    return record(OLD, DEMONSTRATED, 3)


@pytest.fixture(scope="module")
def beginnings(records):
    """The first 100 samples of each record, before the cube is touched."""
    sensors, commands = records.sequences()
    return Records.from_sequences([s[:100] for s in sensors], [c[:100] for c in commands])


SIGMA = 0.1 * np.array(SENSOR_RANGES)


def params(n, theta_i=0.1, sigma=SIGMA):
    return Params(np.full(n, theta_i), np.full(n, 0.05), np.tile(sigma, (n, 1)))


def run(records, positions, jump, constants=LONG, slots=None, theta_i=0.1, env=None):
    """Replays with the cube at positions, in a plane."""
    n = len(positions)
    env = env or PlaneVectorEnv(slots or n, constants)
    seeds = [900 + k for k in range(n)]
    options = {"cube": facing(positions)}
    return replay(records, params(n, theta_i), env, seeds, jump=jump, options=options)


class Recorder(PlaneVectorEnv):
    """A plane that remembers what was sent and seen."""

    def __init__(self, *args):
        super().__init__(*args)
        self.sent, self.seen = [], []

    def step(self, actions):
        result = super().step(actions)
        self.sent.append(actions.copy())
        self.seen.append(result[0].copy())
        return result


@own_tau_first
def test_the_loop_is_predict_command_act_observe_update(records, jump, monkeypatch):
    """Every command sent is the reference's, fed what was seen before it; so is the evidence."""
    monkeypatch.setattr(module, "WINDOWS", ())
    watched = Recorder(1, SHORT)
    result = run(records, TESTED[:1], jump, env=watched)
    sensors, commands = ([a.astype(float) for a in x] for x in records.sequences())
    p = params(1)
    p = reference.Params(float(p.theta_i[0]), float(p.theta_tau[0]), np.asarray(p.sigma[0], float))
    belief, evidence = reference.init(sensors), 0.0
    for sent, seen in zip(watched.sent, watched.seen, strict=True):
        belief = reference.predict(sensors, p, belief, jump)
        np.testing.assert_allclose(sent[0], reference.command(commands, belief), atol=2e-5)
        belief, gained = reference.update(sensors, p, belief, seen[0].astype(float))
        evidence += gained
    assert result.log_evidence[0] == pytest.approx(evidence, rel=1e-5)
    assert result.ending[0] == "truncated"
    assert result.steps[0] == 120
    assert Plane.outcome(result)[0] == "Fs"


@pytest.mark.slow
def test_windows_change_no_command_by_what_the_robot_could_tell(records):
    watched = Recorder(1, replace(LONG, time_limit=80.0))
    run(records, TESTED[:1], "own_tau", env=watched)
    whole, one = build_filter("own_tau", None), Params(0.1, 0.05, SIGMA)
    centred = records.centred()

    def step(belief, z):
        belief = whole.predict(centred, one, belief)
        return whole.update(centred, one, belief, z)[0], whole.command(centred, belief)

    seen = records.centre(np.concatenate(watched.seen))
    _, wanted = jax.jit(lambda z: jax.lax.scan(step, whole.init(centred), z))(seen)
    off = np.abs(np.concatenate(watched.sent) - wanted).max(axis=0)
    unit = LONG.motor_unit
    told = np.array([unit, unit, LONG.elevation_resolution, LONG.tilt_resolution, 1])
    np.testing.assert_array_less(off, told / 10)


def test_a_step_that_drops_too_much_is_done_again_wider(records, monkeypatch):
    monkeypatch.setattr(module, "WINDOWS", (64,))
    result = run(records, TESTED[1:2], "own_tau", SHORT)
    monkeypatch.setattr(module, "WINDOWS", ())
    whole = run(records, TESTED[1:2], "own_tau", SHORT)
    assert result.widened > 0
    assert whole.widened == 0
    assert result.log_evidence == pytest.approx(whole.log_evidence, rel=1e-5)


@pytest.mark.slow
def test_a_tracker_widens_a_window_and_narrows_it_again(records, monkeypatch):
    """Blind for a while its belief spreads, and gathers again; the other replay rests."""
    monkeypatch.setattr(module, "WINDOWS", (64,))
    monkeypatch.setattr(module, "RETURN_AFTER", 0)
    monkeypatch.setattr(module, "MARGIN", 30)
    tracker = module.Tracker(records, params(2), Options("same_tau"))
    whole, one = build_filter("same_tau", None), Params(0.1, 0.05, SIGMA)
    belief = whole.predict(records, one, whole.init(records))
    sensors, _ = records.sequences()
    windows = []
    for t in range(300):
        z = np.full(7, np.nan) if 40 <= t < 100 else sensors[0][t]
        tracker.observe(np.array([z, z]), np.array([True, t < 20]))
        windows.append(tracker.window.copy())
        belief, _ = whole.update(records, one, belief, z)
        belief = whole.predict(records, one, belief)
        np.testing.assert_allclose(tracker.command[0], whole.command(records, belief), atol=1e-4)
    changes, none = np.diff(windows, axis=0).T
    assert set(changes) == {-1, 0, 1}
    assert set(none) == {0}


def test_a_replay_restarted_in_a_tracker_is_a_new_one_and_leaves_the_others_alone(records):
    sensors, _ = records.sequences()
    everyone = np.ones(3, bool)
    first = params(3)
    later = replace(first, theta_i=np.array([0.1, 0.01, 0.1]))
    tracker, undisturbed, fresh = (
        module.Tracker(records, p, Options("own_tau")) for p in (first, first, later)
    )
    for t in range(30):
        for each in (tracker, undisturbed):
            each.observe(np.array([s[t] for s in sensors[:3]]), everyone)
    tracker.begin(np.array([False, True, False]), later)
    for t in range(30):
        z, new = (np.array([s[at] for s in sensors[:3]]) for at in (30 + t, t))
        gained, *_ = tracker.observe(np.where([[False], [True], [False]], new, z), everyone)
        for whose, same, seen in ((undisturbed, [0, 2], z), (fresh, [1], new)):
            theirs, *_ = whose.observe(seen, everyone)
            np.testing.assert_array_equal(gained[same], theirs[same])
            np.testing.assert_array_equal(tracker.command[same], whose.command[same])


def test_replays_fetch_the_cube_where_it_was_demonstrated(records):
    env = PlaneVectorEnv(5, OLD)
    result = run(records, DEMONSTRATED[[2, 7, 11, 13, 17]], "own_tau", theta_i=1e-3, env=env)
    won = Plane.outcome(result) == "S"
    assert won.sum() >= 3
    assert (result.ending[won] == "completed").all()
    assert (result.info["alignment_error"][won] < OLD.magnet_offset).all()
    np.testing.assert_array_equal(env.lifted[won], True)
    assert (result.steps[won] < OLD.max_steps).all()
    assert (result.reward[won] > 0).all()


def test_outcomes_name_what_happened(records, beginnings):
    """With records cut before the grasp the replay ends without the cube; backwards it leaves."""
    ended = run(beginnings, TESTED[:1], "own_tau")
    assert (ended.ending[0], Plane.outcome(ended)[0]) == ("completed", "Fg")
    sensors, commands = records.sequences()
    away = Records.from_sequences(sensors, [np.full_like(c, -0.15) for c in commands])
    left = run(away, TESTED[:1], "own_tau")
    assert (left.ending[0], Plane.outcome(left)[0]) == ("terminated", "Fb")


def same(one, other, which=slice(None)):
    """Whether some replays of one came to the same, to the last bit, as all those of the other."""
    for name in ("ending", "steps", "reward", "log_evidence"):
        np.testing.assert_array_equal(getattr(one, name)[which], getattr(other, name))
    shared = one.info.keys() & other.info.keys()
    assert {"is_success", "stall"} <= shared
    for name in shared:
        np.testing.assert_array_equal(one.info[name][which], other.info[name])


def test_the_same_again_and_no_matter_how_many_beside(records):
    positions = TESTED[np.arange(9) % 5]
    first = run(records, positions, "own_tau", SHORT)
    same(first, run(records, positions, "own_tau", SHORT))
    same(first, run(records, positions[:1], "own_tau", SHORT), slice(1))


def test_more_replays_than_slots_come_to_the_same_as_all_at_once(beginnings):
    positions = DEMONSTRATED[:18:2]
    together = run(beginnings, positions, "own_tau", SHORT)
    assert len(set(together.steps)) > 3  # slots are free at different times
    same(together, run(beginnings, positions, "own_tau", SHORT, slots=3))
    same(together, run(beginnings, positions, "own_tau", SHORT, slots=12))


class Errands(VectorEnv):
    """Worlds that end after as many steps as they are told; who was sent, they tell at the end."""

    metadata = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012 - as in Gymnasium

    def __init__(self, slots):
        self.num_envs = slots
        self.single_observation_space = gymnasium.spaces.Box(-1, 1, (2,))
        self.single_action_space = gymnasium.spaces.Box(-1, 1, (1,))
        self.left, self.who = np.zeros(slots, int), np.full(slots, -1)
        self.started = []

    def reset(self, *, seed=None, options=None):
        mask = options["reset_mask"]
        self.left[mask], self.who[mask] = 1000, -1
        for b in np.flatnonzero(mask) if seed is not None else ():
            if seed[b] is not None:
                self.started.append(seed[b])
                self.left[b], self.who[b] = options["steps"][b], seed[b]
        return np.zeros((self.num_envs, 2)), {}

    def step(self, actions):
        assert (self.left > 0).all()  # none that ended is stepped
        self.left -= 1
        over, odd = self.left == 0, self.who % 2 == 1
        info = {"who": np.where(over, self.who, 0), "_who": over}
        observed = np.zeros((self.num_envs, 2))
        return observed, np.full(self.num_envs, 0.5), over & ~odd, over & odd, info


@pytest.mark.parametrize("slots", [1, 3, 8, 20])
def test_every_replay_is_carried_out_once_with_its_own_seed_and_options(slots):
    sensors = [np.zeros((200, 2))]
    records = Records.from_sequences(sensors, [np.zeros((200, 1))])
    env, n = Errands(slots), 17
    steps = np.random.default_rng(0).integers(1, 40, n)
    seeds = [100 + k for k in range(n)]
    done = []
    result = replay(
        records,
        params(n, sigma=[1, 1]),
        env,
        seeds,
        options={"steps": steps},
        keep=[2, 5],
        progress=lambda so_far: done.append(np.sum(so_far.ending != "")),
    )
    assert sorted(env.started) == seeds
    assert {k: len(seen) for k, seen in result.observations.items()} == {2: steps[2], 5: steps[5]}
    np.testing.assert_array_equal(result.steps, steps)
    np.testing.assert_array_equal(result.reward, steps / 2)
    np.testing.assert_array_equal(result.info["who"], seeds)
    np.testing.assert_array_equal(result.ending, ["terminated", "truncated"] * 8 + ["terminated"])
    assert done[-1] == n
    assert (np.diff(done) >= 0).all()


def test_a_plane_of_single_environments_is_driven_as_the_batch_is(records):
    short = replace(LONG, time_limit=6.0)
    singles = gymnasium.make_vec(
        "jaxreplay/FetchCube-v0",
        num_envs=2,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED},
        params=short,
    )
    seeds = [3, 1, 2]
    one, many = (
        replay(records, params(3), env, seeds, jump="own_tau")
        for env in (singles, PlaneVectorEnv(2, short))
    )
    same(one, many)
