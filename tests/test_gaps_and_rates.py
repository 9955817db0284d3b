"""Records with samples that were not measured, and records at another rate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxreplay import Params, Records, build_filter, reference


def test_a_command_that_is_nan_is_refused_and_so_is_a_sensor_without_any_sample():
    rows, bad = np.ones((3, 2)), np.ones((3, 2))
    bad[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"record 1: commands\[2, 1\] is nan, not a finite"):
        Records.from_sequences([rows, rows], [rows, bad])
    nothing = np.where([True, False], rows, np.nan)
    with pytest.raises(ValueError, match=r"record 1: z1 is NaN in all 3 rows"):
        Records.from_sequences([rows, nothing], [rows, rows])


def test_what_was_not_measured_lies_on_a_straight_line_and_stays_nan(tmp_path):
    rows = np.array([[np.nan, 5], [1, 5], [np.nan, np.nan], [np.nan, 8], [4, np.nan]])
    recorded = [rows, rows[1:] + 1]
    records = Records.from_sequences(recorded, [np.zeros((5, 1)), np.zeros((4, 1))])
    lines = np.array([[1, 5], [1, 5], [2, 6.5], [3, 8], [4, 8]])
    for whole, nan in ((lines, recorded[0]), (lines[1:] + 1, recorded[1])):
        i = 5 - len(whole)
        np.testing.assert_allclose(records.sequences(filled=True)[0][i], whole)
        np.testing.assert_allclose(records.sequences()[0][i], nan)
        np.testing.assert_allclose(reference.filled(nan), whole)
    records.save(tmp_path / "with_gaps.npz")
    again = Records.load(tmp_path / "with_gaps.npz")
    for mine, theirs in zip(again.sequences()[0], recorded, strict=True):
        np.testing.assert_allclose(mine, theirs)
    np.testing.assert_array_equal(again.nodes, records.nodes)
    np.testing.assert_allclose(records.subset([1]).sequences()[0][0], recorded[1])
    measured = Records.from_sequences([lines], [np.zeros((5, 1))])
    assert measured.unmeasured is None


@given(st.integers(1, 40), st.sampled_from([0.25, 0.5, 1.0, 2.0, 3.0, 0.7]), st.integers(0, 99))
def test_records_at_another_rate_end_at_the_same_time_with_the_same_travel(n, ratio, seed):
    rng = np.random.default_rng(seed)
    commands = rng.normal(size=(n, 2))
    sensors = 0.1 * np.cumsum(commands, axis=0)  # where velocities lead
    records = Records.from_sequences([sensors], [commands], period=0.1)
    (observed,), (driven,) = records.resampled(0.1 * ratio).sequences()
    assert len(observed) == max(int(n / ratio + 1e-6), 1)
    period = 0.1 * min(ratio, n)
    travelled = period * np.cumsum(driven, axis=0)
    late = 0.1 * np.arange(1, n + 1)  # the straight lines begin at the first observation
    there = period * np.arange(1, len(observed) + 1) >= late[0] - 1e-9
    np.testing.assert_allclose(observed[there], travelled[there], atol=1e-4)


def test_records_of_unknown_period_are_not_resampled():
    one = [np.ones((3, 2))]
    with pytest.raises(ValueError, match=r"of unknown period cannot be resampled to 0\.2 s"):
        Records.from_sequences(one, one).resampled(0.2)
    timed = Records.from_sequences(one, one, period=0.2)
    assert timed.resampled(0.2) is timed
    with pytest.raises(ValueError, match="period must be a positive number"):
        timed.resampled(0.0)


@pytest.mark.parametrize("jump", ["same_tau", "own_tau"])
def test_the_filter_of_records_with_gaps_is_the_reference(jump):
    rng = np.random.default_rng(1)
    sensors = [rng.normal(size=(n, 2)).cumsum(axis=0) for n in (30, 40)]
    seen = sensors[1][:25] + 0.2 * rng.normal(size=(25, 2))
    for rows in sensors:
        rows[rng.random(rows.shape) < 0.3] = np.nan
    commands = [rng.normal(size=(len(s), 1)) for s in sensors]
    records, sigma = Records.from_sequences(sensors, commands), np.array([0.5, 0.4])
    filter, params = build_filter(jump), Params(0.1, 0.05, sigma)
    belief, same = filter.init(records), reference.Params(0.1, 0.05, sigma)
    wanted = reference.init(sensors)
    for z in seen:
        belief = filter.predict(records, params, belief)
        wanted = reference.predict(sensors, same, wanted, jump)
        belief, log_evidence = filter.update(records, params, belief, z)
        wanted, gained = reference.update(sensors, same, wanted, z)
        np.testing.assert_allclose(filter.posterior(records, belief), np.exp(wanted), atol=5e-5)
        assert float(log_evidence) == pytest.approx(gained, abs=1e-3)
