"""A robot of one's own: starts, ends, rates, ranges of commands, and robots that are lost."""

import warnings
from typing import ClassVar

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest
from filter_helpers import own_tau_first
from gymnasium.vector import AutoresetMode, VectorEnv

from jaxreplay import Params, Records, Replayer, build_filter, log_evidence, reference, replay
from jaxreplay.errors import ConfigError
from jaxreplay.loop.replay import LostWarning

ROWS = 39
SIGMA = np.array([0.05])


class Line(VectorEnv):
    """Robots on a line: they move by their action, and see where they are."""

    metadata: ClassVar = {"autoreset_mode": AutoresetMode.DISABLED}

    def __init__(self, n=1, steps=60, action=np.float32, start=0.0, sign=1.0, period=None):
        self.num_envs, self.steps, self.start, self.sign = n, steps, start, sign
        self.single_observation_space = gymnasium.spaces.Box(-9, 9, (1,))
        high = 300 if np.issubdtype(action, np.integer) else 9
        self.single_action_space = gymnasium.spaces.Box(-high, high, (1,), action)
        self.control_period, self.actions = period, []

    def reset(self, *, seed=None, options=None):
        fresh = options["reset_mask"]
        if not hasattr(self, "x"):
            self.x, self.t = np.zeros(self.num_envs), np.zeros(self.num_envs, int)
        self.x[fresh], self.t[fresh] = self.start, 0
        return self.sign * self.x[:, None], {}

    def step(self, actions):
        assert all(action in self.single_action_space for action in actions)
        self.actions.append(actions)
        self.x = self.x + actions[:, 0]
        self.t = self.t + 1
        nothing = np.zeros(self.num_envs)
        seen = self.sign * self.x[:, None]
        info = {"x": self.x.copy()}
        return seen, nothing, nothing > 0, self.t >= self.steps, info


def ways(period=None, shift=(0.0, 0.01)):
    """Two records of 39 rows, each 1/39 of the way to 1."""
    commands = np.full((ROWS, 1), 1 / ROWS)
    sensors = [np.cumsum(commands, axis=0) + x for x in shift]
    return Records.from_sequences(sensors, [commands] * 2, period=period)


def parameters(n, sigma=SIGMA):
    return Params(np.full(n, 0.01), np.full(n, 0.05), np.tile(sigma, (n, 1)))


@pytest.mark.parametrize(
    ("last_steps", "ending"), [(10, "completed"), (1, "completed"), (None, ""), (0, "")]
)
def test_a_replay_ends_where_last_steps_says(last_steps, ending):
    done = replay(ways(), parameters(1), Line(), [0], last_steps=last_steps)
    reached = done.info["x"][0]
    assert done.ending[0] == ("completed" if last_steps else "truncated")
    if last_steps == 10:
        assert reached < 0.85  # the paper's rule stops this robot ten rows early
    else:
        assert reached > 0.97


def test_a_replayer_ends_there_too():
    for last_steps, early in ((10, True), (1, False), (None, False)):
        replayer, x, t = Replayer(ways(), Params(0.01, 0.05, SIGMA), last_steps=last_steps), 0.0, 0
        while replayer.end_probability <= 0.9 and t < 60:
            x += float(replayer.command()[0])
            replayer.observe([x])
            t += 1
        assert (x < 0.85) == early
        assert t < 60


@pytest.mark.parametrize("name", ["start", "last_steps", "jump"])
def test_options_without_such_a_value_are_refused(name):
    bad = {"start": "middle", "last_steps": -1, "jump": "both"}[name]
    with pytest.raises(ValueError, match=f"{name} must be .*; got {bad!r}"):
        Replayer(ways(), Params(0.01, 0.05, SIGMA), **{name: bad})
    with pytest.raises(ValueError, match=f"{name} must be .*; got {bad!r}"):
        replay(ways(), parameters(1), Line(), [0], **{name: bad})


def test_an_end_as_long_as_the_records_is_refused():
    with pytest.raises(ValueError, match="the longest record has 39 rows: every replay would end"):
        Replayer(ways(), Params(0.01, 0.05, SIGMA), last_steps=39)
    with pytest.raises(ValueError, match="the longest record has 39 rows"):
        replay(ways(), parameters(1), Line(), [0], last_steps=40)


def test_what_is_no_records_params_seeds_or_vector_environment_is_refused():
    records, params = ways(), Params(0.01, 0.05, SIGMA)
    for given, message in (
        (({"x": 1}, params), "records is a dict; make them with"),
        ((records, {"sigma": 1}), "params is a dict; make them with jr.Params"),
    ):
        with pytest.raises(ValueError, match=message):
            Replayer(*given)
        with pytest.raises(ValueError, match=message):
            replay(*given, Line(), [0])
    with pytest.raises(ValueError, match="seeds is 4; give a list"):
        replay(records, params, Line(), 4)
    with pytest.raises(ValueError, match="not a vector environment; make it with"):
        replay(records, params, gymnasium.make("MountainCarContinuous-v0"), [0])
    with pytest.raises(ConfigError, match="no controller neerest; did you mean nearest"):
        replay(records, params, Line(), [0], controller="neerest")


def test_one_set_of_parameters_serves_all_replays_and_controllers_have_names():
    one, records = Params(0.01, 0.05, SIGMA), ways()
    filtered = replay(records, one, Line(2), range(3), last_steps=1)
    np.testing.assert_array_equal(
        filtered.steps, replay(records, parameters(3), Line(2), range(3), last_steps=1).steps
    )
    taped = replay(records, one, Line(2), range(3), controller="tape")
    assert (taped.ending == "completed").all()


@own_tau_first
def test_a_start_anywhere_is_the_reference(jump):
    rng = np.random.default_rng(0)
    sensors = [rng.normal(size=(n, 2)).cumsum(axis=0) for n in (230, 300)]
    sensors = [s.astype(np.float32).astype(float) for s in sensors]
    commands = [rng.normal(size=(len(s), 2)).astype(np.float32) for s in sensors]
    records, sigma = Records.from_sequences(sensors, commands), np.array([0.5, 0.7])
    replayer = Replayer(records, Params(0.01, 0.05, sigma), jump, start="anywhere")
    params = reference.Params(0.01, 0.05, sigma)
    for again in range(2):
        belief = reference.init(sensors, "anywhere" if again == 0 else "first")
        for t in range(100, 140):
            belief = reference.predict(sensors, params, belief, jump)
            want = reference.command(commands, belief)
            np.testing.assert_allclose(replayer.command(), want, atol=1e-3)
            replayer.observe(sensors[1][t])
            belief, _ = reference.update(sensors, params, belief, sensors[1][t])
            i, j = np.unravel_index(belief.argmax(), belief.shape)
            apart = (np.abs(sensors[i][j] - sensors[1][t]) / sigma).max()
            assert replayer.following.distance == pytest.approx(apart, abs=1e-3)
        if again == 0:
            record, moment, _, distance = replayer.following
            assert (record, distance) == (1, 0)
            assert abs(moment - 140) <= 1
        replayer.reset(start="first")


def test_a_start_anywhere_is_not_for_a_window():
    with pytest.raises(ValueError, match="a start anywhere needs window=None"):
        build_filter("own_tau", 32).init(ways(), "anywhere")


def test_from_the_middle_only_a_start_anywhere_is_not_lost():
    found = replay(ways(), parameters(1), Line(start=0.5), [0], start="anywhere", last_steps=1)
    assert found.steps[0] < 25
    assert found.distance_median[0] < 0.5
    with pytest.warns(LostWarning, match="1 of 1 replays were lost"):
        lost = replay(ways(), parameters(1), Line(sign=-1.0), [0], last_steps=1)
    assert lost.distance_median[0] > 3
    assert lost.distance_max[0] >= lost.distance_median[0]


def test_commands_stay_within_what_was_recorded():
    rng = np.random.default_rng(3)
    sensors = [rng.normal(size=(50, 3)).cumsum(axis=0) for _ in range(9)]
    records = Records.from_sequences(sensors, [np.ones((50, 1))] * 9)
    filter, params = build_filter(), Params(0.3, 0.2, [1.0, 1.0, 1.0])
    replayer, belief, above = Replayer(records, params), filter.init(records), 0.0
    for z in sensors[4]:
        belief = filter.predict(records, params, belief)
        above = max(above, float(filter.command(records, belief)[0]) - 1)
        belief, _ = filter.update(records, params, belief, z)
        assert replayer.command()[0] == 1.0
        replayer.observe(z)
    assert above > 0  # equation 8 itself is an expectation, rounded


def test_whole_actions_are_rounded_not_cut():
    commands = np.full((ROWS, 1), 253.0)
    commands[::13] = 252.9
    records = Records.from_sequences([np.arange(ROWS)[:, None] / ROWS] * 2, [commands] * 2)
    env = Line(action=np.int64, steps=30, sign=1 / 9999)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LostWarning)
        replay(records, parameters(1), env, [0], last_steps=None)
    assert {int(action[0, 0]) for action in env.actions} == {253}


@pytest.mark.parametrize("period", [0.2, 0.05])
def test_a_robot_at_another_rate_gets_resampled_records(period):
    rate = period / 0.1
    steps = round(60 / rate)
    assert abs(drive(ways(0.1), Line(steps=steps, period=period), rate) - 1) < 0.03
    assert abs(drive(ways(0.1), Line(steps=steps), rate, period=period) - 1) < 0.03
    # Taken as they are, at half the rate they drive twice as far, until the robot is lost.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LostWarning)
        assert abs(drive(ways(), Line(steps=steps, period=period), rate) - 1) > 0.05 or rate < 1
    replayer, x = Replayer(ways(0.1), Params(0.01, 0.05, SIGMA), last_steps=1, period=period), 0.0
    while replayer.end_probability <= 0.9:
        x += rate * float(replayer.command()[0])
        replayer.observe([x])
    assert abs(x - 1) < 0.06


def drive(records, line, rate, **more):
    """Return where a robot comes to whose commands are speeds, on a longer or shorter step."""

    class Faster(type(line)):
        def step(self, actions):
            return super().step(rate * actions)

    line.__class__ = Faster
    return replay(records, parameters(1), line, [0], last_steps=1, **more).info["x"][0]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("theta_i", np.full(2, 0.01)),
        ("theta_tau", np.array(0.05)),
        ("sigma", np.full((2, 1), 0.1)),
    ],
)
def test_a_batch_of_another_length_is_refused(name, value):
    given = {"theta_i": np.full(4, 0.01), "theta_tau": np.full(4, 0.05), "sigma": np.ones((4, 1))}
    with pytest.raises(ValueError, match=f"{name} has shape .*; 4 seeds and 1 sensors need"):
        replay(ways(), Params(**given | {name: value}), Line(4), range(4))
    with pytest.raises(ValueError, match=r"options\['cube'\] has shape \(3,\); a value for"):
        replay(ways(), Params(**given), Line(4), range(4), options={"cube": np.zeros(3)})


def test_infinite_observations_are_refused_and_traced_ones_pass():
    records, params, filter = ways(), Params(0.01, 0.05, SIGMA), build_filter()
    belief = filter.predict(records, params, filter.init(records))
    for z in (np.array([np.inf]), jnp.array([-jnp.inf]), np.array([1e300])):
        with pytest.raises(ValueError, match=r"z\[0\] \(z0\) is infinite in float32; give NaN"):
            filter.update(records, params, belief, z)
        with pytest.raises(ValueError, match=r"observations\[1, 0\] \(z0\) is infinite"):
            log_evidence(records, params, np.stack([0 * z + 1 if np.isfinite(z[0]) else [1], z]))
