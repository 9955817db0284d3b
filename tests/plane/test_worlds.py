from dataclasses import replace

import numpy as np
import pytest
from plane_helpers import EXACT, HIGH, OLD, plane_with, random_actions


@pytest.mark.parametrize("traction", [0.6, 0.02])
def test_poses_are_those_of_pymunk_where_it_need_not_be_asked(traction):
    rng = np.random.default_rng(1)
    cubes = np.column_stack([rng.uniform([0.2, -0.1], [0.4, 0.1], (12, 2)), np.zeros(12)])
    params = replace(OLD, traction=traction)
    fast, slow = (plane_with(*cubes, params=params, placing=0.01) for _ in range(2))
    asked = []

    def simulate_all(motion, pose):
        asked.append(free(motion, pose))
        return np.zeros(12, bool)

    free, slow._worlds._free = slow._worlds._free, simulate_all
    start, untouched = slow.pose.cube.copy(), np.ones(12, bool)
    for actions in np.repeat(random_actions(rng, 20, 12), 10, axis=0):  # for a second each
        fast.step(actions)
        slow.step(actions)
        untouched &= (slow.pose.cube == start).all(axis=1)  # a contact magnifies the last digit
        for one, other in zip(fast.pose, slow.pose, strict=True):
            np.testing.assert_allclose(one[untouched], other[untouched], atol=1e-12)
    assert 0.2 < np.mean(asked) < 0.8  # both happened often
    assert 0 < untouched.sum() < 12


def test_a_push_that_comes_after_a_drive_alone_starts_where_the_robot_is():
    env = plane_with((0.5, 0, 0))
    stop = 0.5 - EXACT.side / 2 - EXACT.reach
    for _ in range(200):
        env.step(np.array([[0.03, 0.03, HIGH if env.pose.robot[0, 0] < 0.2 else 0, 0, 0]]))
    assert env.pose.robot[0, 0] == pytest.approx(0.6 - 0.03 * 0.02, abs=1e-6)
    assert env.pose.cube[0, 0] - 0.5 == pytest.approx(env.pose.robot[0, 0] - stop, abs=2e-3)
