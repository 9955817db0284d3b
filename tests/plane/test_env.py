from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from plane_helpers import (
    AWAY,
    EXACT,
    HIGH,
    LOW,
    OLD,
    PERIOD,
    UNIT,
    plane_with,
    random_actions,
    send,
)

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import seed_of
from jaxreplay.plane.single import PlaneEnv

NAME = "jaxreplay/FetchCube-v0"
STAY = np.array([0, 0, HIGH, 0, 0])


@pytest.mark.filterwarnings("ignore:.*symmetric and normalized")  # actions are SI units
def test_gymnasium_finds_nothing_to_complain_about():
    check_env(gymnasium.make(NAME).unwrapped)


def test_gymnasium_makes_a_batch():
    env = gymnasium.make_vec(NAME, num_envs=3, vectorization_mode="vector_entry_point")
    observations, _ = env.reset(seed=1)
    assert observations in env.observation_space
    observations, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert observations in env.observation_space
    for each in (reward, terminated, truncated, *info.values()):
        assert each.shape == (3,)
    assert env.metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.DISABLED
    env.close()


def test_only_leaving_the_area_terminates():
    env = plane_with((0.3, 0, 0), AWAY)
    moves = np.array([[-0.1, -0.1, HIGH, 0, 0], [0.1, 0.1, HIGH, 0, 0]])
    steps = int((-EXACT.area[0] - EXACT.hull_radius) / (0.1 * PERIOD))
    for _ in range(steps):
        *_, terminated, truncated, _ = env.step(moves)
        assert not terminated.any()
    *_, terminated, truncated, _ = env.step(moves)
    np.testing.assert_array_equal(terminated, [True, False])
    assert not truncated.any()


@pytest.mark.parametrize(
    ("turn", "axis", "border"), [(0, 0, 1), (np.pi, 0, 0), (np.pi / 2, 1, 3), (-np.pi / 2, 1, 2)]
)
def test_the_hull_crosses_each_border(turn, axis, border):
    env = plane_with((0.6, 0.25, 0))
    steps = 40
    spin = turn / (steps * PERIOD) * EXACT.track_separation / 2
    send(env, [-spin, spin, HIGH, 0, 0], steps * PERIOD)
    send(env, STAY, 1)
    terminated = [False]
    while not terminated[0]:
        before = env.pose.robot[0, axis]
        *_, terminated, _, _ = env.step(np.array([[0.1, 0.1, HIGH, 0, 0]]))
    edge = np.abs(EXACT.area[border]) - EXACT.hull_radius
    assert abs(before) <= edge < abs(env.pose.robot[0, axis])


@pytest.mark.parametrize("time_limit", [0.5, 2.0])
def test_the_time_limit_truncates_and_does_not_terminate(time_limit):
    env = plane_with(AWAY, params=replace(EXACT, time_limit=time_limit))
    for step in range(1, round(time_limit / PERIOD) + 1):
        *_, terminated, truncated, info = env.step(STAY[None])
        assert not terminated[0]
        assert truncated[0] == (step == round(time_limit / PERIOD))
    assert info["stall"][0] == "fixed"


def everything(env):
    """The state of all worlds `[B, …]`; the alignment error is −1 before the first grasp."""
    return np.column_stack([*env.pose, env.held, np.nan_to_num(env.alignment_error, nan=-1)])


def test_a_world_that_has_ended_rests_until_it_is_reset():
    env = plane_with((0.2, 0, 0), (0.2, 0, 0), AWAY, params=replace(EXACT, time_limit=12.0))
    env.resting[1] = True  # the caller may do so as well
    send(env, [0, 0, LOW, 0, 1], 4)
    send(env, [0.01, 0.01, LOW, 0, 1], 4)
    *_, truncated, info = send(env, [0, 0, HIGH, 0, 1], 4)
    np.testing.assert_array_equal(truncated, [True, False, True])
    np.testing.assert_array_equal(info["is_success"], [True, False, False])
    np.testing.assert_array_equal(env.pose.elevation[1], HIGH)
    before = everything(env)
    moves = np.tile([0.05, -0.05, LOW, 1, 0], (3, 1))
    seen = [env.step(moves) for _ in range(5)]
    np.testing.assert_array_equal(everything(env), before)
    for observations, reward, terminated, truncated, _ in seen:
        np.testing.assert_array_equal(observations, seen[0][0])
        assert not np.concatenate([reward, terminated, truncated]).any()
    env.reset(seed=[1, 2, 3], options={"reset_mask": np.array([True, False, False])})
    env.step(moves)
    np.testing.assert_array_equal((everything(env) != before).any(axis=1), [True, False, False])


def test_the_single_environment_behaves_as_a_batch_of_one():
    params = replace(OLD, time_limit=4.0)
    single, batch = PlaneEnv(params), PlaneVectorEnv(1, params)
    options = {"cube": np.array([0.22, 0.03, 0.2]), "dithering": True, "battery": 0.8}
    one, _ = single.reset(seed=5, options=options)
    many, _ = batch.reset(seed=[5], options={k: np.array([v]) for k, v in options.items()})
    np.testing.assert_array_equal(one, many[0])
    for action in random_actions(np.random.default_rng(0), 40, 1):
        one, many = single.step(action[0]), batch.step(action)
        np.testing.assert_array_equal(one[0], many[0][0])
        assert one[1:4] == tuple(x[0] for x in many[1:4])
        for name, value in one[4].items():
            assert value == many[4][name][0]
    assert one[3]
    assert one[4]["stall"] in ("fixed", "cyclic", "slow")
    again, _ = single.reset(seed=5, options=options)
    np.testing.assert_array_equal(
        again, batch.reset(seed=5, options={k: np.array([v]) for k, v in options.items()})[0][0]
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cub": np.zeros((2, 3))}, "unknown option cub; did you mean cube"),
        ({"cube": np.zeros(3)}, r"cube must be 2 finite x, y \(m\) and angle"),
        ({"cube": np.full((2, 3), np.nan)}, "cube must be 2 finite"),
        ({"motor_unit": np.array([0.005, 0])}, r"motor_unit must be 2 values in \[1e-06, 0\.3\]"),
        ({"battery": np.array([1.0, 9.0])}, r"battery must be 2 values in \[0\.05, 1\.5\]"),
        ({"battery": 1.0}, "battery must be 2 values"),
        ({"sensor_noise": np.array([0, np.nan])}, r"sensor_noise must be 2 values in \[0, 100\]"),
        ({"dithering": np.array([0, 2])}, r"dithering must be 2 values in \[0, 1\]"),
        ({"reset_mask": np.array([True])}, "reset_mask must be 2 booleans; got bool"),
        ({"reset_mask": np.array([1, 0])}, "reset_mask must be 2 booleans; got int"),
    ],
)
def test_bad_options_are_errors(options, message):
    with pytest.raises(ValueError, match=message):
        PlaneVectorEnv(2).reset(seed=1, options=options)


@pytest.mark.parametrize("seed", [[1], [1, 2, 3], [1, -1], -1, 0.5, [0.5, 1]])
def test_bad_seeds_are_errors(seed):
    with pytest.raises(ValueError, match="seed"):
        PlaneVectorEnv(2).reset(seed=seed)


@pytest.mark.parametrize(
    "actions", [np.zeros((2, 4)), np.zeros(5), np.full((2, 5), np.nan), np.full((2, 5), np.inf)]
)
def test_bad_actions_are_errors(actions):
    env = plane_with(AWAY, AWAY)
    with pytest.raises(ValueError, match="actions must be 2 × 5 finite numbers"):
        env.step(actions)


def test_a_reset_that_fails_leaves_all_as_it_was():
    env = plane_with((0.3, 0, 0), AWAY)
    before = everything(env)
    for seed, options in (([3, -1], {}), ([3, 4], {"battery": np.zeros(2)})):
        with pytest.raises(ValueError):  # noqa: PT011 - any message
            env.reset(seed=seed, options=options)
        np.testing.assert_array_equal(everything(env), before)


def test_actions_beyond_the_limits_are_clipped():
    far = plane_with(AWAY)
    limit = plane_with(AWAY)
    send(far, [9, 9, 9, 9, 9], 1)
    send(limit, limit.action_space.high[0], 1)
    np.testing.assert_allclose(everything(far), everything(limit), rtol=1e-6)


def test_cubes_not_specified_are_placed_25_to_40_cm_ahead_a_face_turned_to_the_robot():
    n = 400
    env = PlaneVectorEnv(n, OLD)
    env.reset(seed=3)
    x, y, angle = env.pose.cube.T
    for values, low, high in ((x, 0.25, 0.40), (y, -0.1, 0.1)):
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < values.max() <= high
        spread = (high - low) / np.sqrt(12 * n)
        assert values.mean() == pytest.approx((low + high) / 2, abs=5 * spread)
    np.testing.assert_allclose(angle, np.arctan2(y, x))


def log_of(keys, actions, slots=None, env=None):
    """Observations, states, results and info of the runs with some keys, step by step."""
    slots = np.arange(len(keys)) if slots is None else slots
    env = env or PlaneVectorEnv(len(keys), OLD)
    env.reset(seed=[seed_of(7, k) for k in keys], options=options_of(keys))
    log = []
    for action in actions:
        observations, *results, info = env.step(action[keys])
        results += [info[name] for name in ("is_success", "alignment_error", "stall")]
        log.append((observations[slots], everything(env)[slots], *(r[slots] for r in results)))
    return [np.array(part) for part in zip(*log, strict=True)]


def options_of(keys):
    """Every third run grasps its cube if the actions do; every other one dithers."""
    keys = np.asarray(keys)
    cube = np.column_stack([0.2 + 0.002 * keys, 0.001 * (keys % 7), 0.01 * (keys % 5)])
    return {
        "cube": cube,
        "dithering": keys % 2 == 0,
        "battery": 0.8 + 0.01 * keys,
        "motor_unit": np.where(keys % 3, UNIT, 0.01),
        "track_bias": np.where(keys % 3, 0.1, 0.01),
        "placing": np.where(keys % 3, 0.01, 0.0),
        "cube_turn": np.where(keys % 3, 0.1, 0.01),
    }


@pytest.fixture(scope="module")
def actions():
    """64 runs of all sorts; the first halves of some fetch the cube."""
    made = random_actions(np.random.default_rng(1), 200, 64)
    fetch = np.tile([0.01, 0.01, LOW, 0, 1], (160, 1))
    fetch[:40, :2] = 0
    fetch[100:] = 0, 0, HIGH, 0, 1
    made[:160, ::3] = fetch[:, None]
    return made


def test_a_run_is_the_same_alone_among_64_and_in_any_order(actions):
    everyone = np.arange(64)
    together = log_of(everyone, actions)
    errors = together[6]
    assert np.isfinite(errors[-1]).sum() > 5  # some grasped
    order = np.random.default_rng(2).permutation(64)
    for part, permuted in zip(together, log_of(order, actions), strict=True):
        np.testing.assert_array_equal(part[:, order], permuted)
    for k in (0, 1, 5, 30, 63):
        for part, alone in zip(together, log_of([k], actions), strict=True):
            np.testing.assert_array_equal(part[:, [k]], alone)


def test_a_restart_in_a_slot_is_a_fresh_world_and_leaves_the_others_alone(actions):
    fresh = log_of([4, 5, 6], actions)
    env = PlaneVectorEnv(3, OLD)
    log_of([0, 5, 3], actions[:160], env=env)
    np.testing.assert_array_equal(env.lifted, [True, False, True])
    env.reset(seed=[seed_of(7, k) for k in (0, 5, 3)], options=options_of([0, 5, 3]))
    half = len(actions) // 2
    for action in actions[:half]:
        env.step(action[[0, 5, 3]])
    others = np.array([True, False, True])
    before = everything(env)[1].copy()
    env.reset(
        seed=[seed_of(7, k) for k in (4, 5, 6)],
        options=options_of([4, 5, 6]) | {"reset_mask": others},
    )
    np.testing.assert_array_equal(everything(env)[1], before)
    for t in range(half):
        going = np.where(others[:, None], actions[t, [4, 5, 6]], actions[half + t, [4, 5, 6]])
        observations, *_ = env.step(going)
        was = np.where(others, t, half + t)
        np.testing.assert_array_equal(observations, fresh[0][was, range(3)])
        np.testing.assert_array_equal(everything(env), fresh[1][was, range(3)])


def test_a_step_before_the_reset_is_refused():
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset before step"):
        PlaneVectorEnv(2).step(np.zeros((2, 5)))


@pytest.mark.parametrize("cube", [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (-0.05, 0.06, 1.0)])
def test_a_cube_on_the_robot_is_refused(cube):
    env = PlaneVectorEnv(2)
    with pytest.raises(ValueError, match="cube is on the robot"):
        env.reset(seed=1, options={"cube": np.array([(0.3, 0.0, 0.0), cube])})
    # Beside the hull it may stand.
    env.reset(seed=1, options={"cube": np.array([(0.3, 0.0, 0.0), (0.2, 0.0, 0.0)])})
