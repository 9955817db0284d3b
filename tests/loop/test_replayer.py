from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from random_helpers import as_float32, random_sequences

from jaxreplay import Params, Records, Replayer, build_filter, reference
from jaxreplay.loop import replayer as live
from jaxreplay.loop import tracker

SIGMA = np.array([0.5, 2.0])
THETA = 0.125, 0.0625
THE_SAME = reference.Params(*THETA, SIGMA)


def records_and_params(lengths=(200, 160, 120)):
    sensors, commands = random_sequences(11, lengths)
    return sensors, commands, Records.from_sequences(sensors, commands), Params(*THETA, SIGMA)


@pytest.fixture(
    scope="module", params=["own_tau", pytest.param("same_tau", marks=pytest.mark.slow)]
)
def replayer(request):
    sensors, commands, records, params = records_and_params()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracker, "WINDOWS", (64,))  # to compile less
        made = Replayer(records, params, request.param)
        made.jump, made.sensors, made.commands = request.param, sensors, commands
        yield made


def test_it_is_the_reference_with_numpy_in_and_out(replayer):
    replayer.reset()
    belief = reference.init(replayer.sensors)
    rng = np.random.default_rng(0)
    for t in range(40):
        belief = reference.predict(replayer.sensors, THE_SAME, belief, replayer.jump)
        command = replayer.command()
        assert type(command) is np.ndarray
        np.testing.assert_allclose(command, reference.command(replayer.commands, belief), atol=2e-5)
        z = as_float32(replayer.sensors[1][t] + 0.3 * rng.normal(size=2))
        gained = replayer.observe(z)
        belief, expected = reference.update(replayer.sensors, THE_SAME, belief, z)
        assert gained == pytest.approx(expected, abs=1e-4)


def test_it_follows_the_record_it_sees_to_its_end(replayer):
    replayer.reset()
    seen = replayer.sensors[1]
    for t, z in enumerate(seen):
        replayer.command()
        replayer.observe(z)
        if t == 100:
            record, moment, probability, distance = replayer.following
            assert record == 1
            assert abs(moment - 101) <= 2
            assert 0 < probability <= 1
            assert distance < 0.5
    assert replayer.end_probability > 0.9


def test_a_mistake_leaves_the_belief_as_it_was(replayer):
    replayer.reset()
    for z in replayer.sensors[0][:10]:
        replayer.command()
        replayer.observe(z)
    with pytest.raises(ValueError, match="call command\\(\\) first"):
        replayer.observe(replayer.sensors[0][10])
    before, evidence = replayer.following, replayer.log_evidence
    replayer.command()
    for wrong, message in (
        ([1.0], r"shape \(1,\); \(2,\) is needed, a value for each of z0, z1"),
        (np.zeros((1, 2)), "shape"),
        ([0.0, np.inf], "z1 is inf; give NaN"),
        ([1e60, 0.0], "z0 is 1e\\+60"),
        (["a", 1], "not an array of numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            replayer.observe(wrong)
    assert (replayer.following, replayer.log_evidence) == (before, evidence)
    replayer.observe(replayer.sensors[0][10])


def test_commands_go_on_by_time_alone(replayer):
    replayer.reset()
    belief = reference.init(replayer.sensors)
    for _ in range(5):
        belief = reference.predict(replayer.sensors, THE_SAME, belief, replayer.jump)
        np.testing.assert_allclose(
            replayer.command(), reference.command(replayer.commands, belief), atol=2e-5
        )
    assert replayer.log_evidence == pytest.approx(0, abs=1e-6)


def test_reset_starts_again(replayer):
    replayer.reset()
    first = replayer.command()
    replayer.observe(replayer.sensors[0][0])
    assert replayer.log_evidence != 0
    replayer.reset()
    np.testing.assert_array_equal(replayer.command(), first)
    assert replayer.log_evidence == 0


def test_parameters_must_fit_the_records():
    _, _, records, _ = records_and_params((30, 20))
    with pytest.raises(ValueError, match=r"2 values of σ are needed \(z0, z1\)"):
        Replayer(records, Params(*THETA, [1.0]))
    with pytest.raises(ValueError, match="one θ_I"):
        Replayer(records, Params([0.1, 0.2], [0.1, 0.1], [[1.0, 1.0], [1.0, 1.0]]))


def test_positions_far_from_the_origin_are_as_good_as_near():
    """UTM coordinates in metres with σ = 0.1, which float32 holds to half a metre."""
    rng = np.random.default_rng(0)
    origin = np.array([500_123.4, 5_250_987.6])
    near = [0.05 * rng.normal(size=(60, 2)).cumsum(0) for _ in range(3)]
    commands = [rng.normal(size=(60, 1)) for _ in near]
    records = Records.from_sequences([s + origin for s in near], commands)
    filter, params = build_filter(), Params(*THETA, [0.1, 0.1])
    same = reference.Params(*THETA, np.array([0.1, 0.1]))
    belief, expected = filter.init(records), reference.init(near)
    for t in range(30):
        z = near[0][t] + 0.05 * rng.normal(size=2)
        belief = filter.predict(records, params, belief)
        expected = reference.predict(near, same, expected)
        belief, evidence = filter.update(records, params, belief, z + origin)
        expected, expected_evidence = reference.update(near, same, expected, z)
        np.testing.assert_allclose(filter.posterior(records, belief), np.exp(expected), atol=2e-5)
        assert evidence == pytest.approx(expected_evidence, abs=1e-4)
    back, _ = records.sequences()
    np.testing.assert_allclose(back[0], near[0] + origin, atol=1e-7)


def test_near_values_have_no_offset():
    _, _, records, _ = records_and_params((30, 20))
    assert records.offset == (0, 0)


def test_what_float32_cannot_hold_is_warned_of():
    records = Records.from_sequences([np.linspace(0, 1e5, 50)[:, None]], [np.zeros((50, 1))])
    with pytest.warns(UserWarning, match="z0 has values 1000000 σ from 0, where float32"):
        live.check_fit(records, Params(*THETA, [0.1]))


def test_two_threads_may_share_it(replayer):
    """One commands and observes; another asks what is followed. Results are as of one thread."""
    replayer.reset()
    zs = [s + 0.1 for s in replayer.sensors[0][:60]]

    def drive():
        return np.array([(replayer.command(), replayer.observe(z))[0] for z in zs])

    alone = drive()
    replayer.reset()
    with ThreadPoolExecutor(2) as threads:
        driven = threads.submit(drive)
        seen = [replayer.following.probability for _ in iter(lambda: driven.done(), True)]
        np.testing.assert_array_equal(driven.result(), alone)
    assert all(0 < p <= 1 + 1e-6 for p in seen)
