"""The loop drives any Gymnasium environment with Box observations and actions."""

import gymnasium
import numpy as np
import pytest
from filter_helpers import own_tau_first
from gymnasium.vector import AutoresetMode

from jaxreplay import Params, Records
from jaxreplay.loop.replay import replay

pytestmark = pytest.mark.usefixtures("fewer_windows")


def params(n, sigma):
    return Params(np.full(n, 0.1), np.full(n, 0.05), np.tile(sigma, (n, 1)))


def mountain_car(slots, mode=AutoresetMode.DISABLED):
    return gymnasium.make_vec(
        "MountainCarContinuous-v0",
        num_envs=slots,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
    )


@pytest.fixture(scope="module")
def climbs():
    """Pushing where it rolls brings the car up the mountain; the episodes end at the flag."""
    car = gymnasium.make("MountainCarContinuous-v0").unwrapped
    sensors, commands = [], []
    for seed in range(10):
        z, _ = car.reset(seed=seed)
        seen, sent, up = [z], [], False
        while not up:
            sent.append(np.array([1.0 if z[1] >= 0 else -1.0], np.float32))
            z, _, up, *_ = car.step(sent[-1])
            seen.append(z)
        sensors.append(np.array(seen))
        commands.append(np.array(sent))
    return Records.from_steps(sensors, commands, ["position", "velocity"], ["force"])


@own_tau_first
def test_an_environment_of_somebody_else_is_driven_too(climbs, jump):
    n = 30
    sigma = 0.05 * np.array([1.8, 0.14])  # of its position's and velocity's ranges
    seeds = [100 + k for k in range(n)]
    # By the paper's rule replays end ten samples before the flag, and none reaches it.
    result = replay(climbs, params(n, sigma), mountain_car(5), seeds, jump=jump, last_steps=None)
    assert np.mean(result.ending == "terminated") > 0.9
    assert result.distance_median.max() < 3
    assert result.reward[result.ending == "terminated"].min() > 80  # 100 at the flag, less its way
    demonstrated = np.asarray(climbs.lengths)
    assert 0.8 * demonstrated.min() < result.steps.min()
    assert result.steps.max() < 1.2 * demonstrated.max()


def test_by_the_papers_rule_it_ends_ten_samples_before_the_flag(climbs):
    sigma = 0.05 * np.array([1.8, 0.14])
    result = replay(climbs, params(3, sigma), mountain_car(3), [100, 101, 102])
    assert (result.ending == "completed").all()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_an_environment_that_resets_itself_is_refused(climbs, mode):
    with pytest.raises(ValueError, match=r"autoreset mode is .*make it with AutoresetMode\.DISAB"):
        replay(climbs, params(1, [1, 1]), mountain_car(1, mode), [0])


@pytest.mark.parametrize(
    ("name", "sizes", "message"),
    [
        ("MountainCarContinuous-v0", (3, 1), r"observations are Box.*the records have 3 numbers"),
        ("MountainCarContinuous-v0", (2, 2), r"actions are Box.*the records have 2 numbers"),
        ("CartPole-v1", (4, 1), r"actions are Discrete\(2\); the records have 1 numbers"),
    ],
)
def test_an_environment_that_does_not_fit_the_records_is_refused(name, sizes, message):
    env = gymnasium.make_vec(
        name, vectorization_mode="sync", vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED}
    )
    records = Records.from_sequences(*([np.zeros((20, size))] for size in sizes))
    with pytest.raises(ValueError, match=message):
        replay(records, params(1, np.ones(sizes[0])), env, [0])
