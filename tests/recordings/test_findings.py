"""Findings one by one: an example that each names, and one that it must not name."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_helpers import LENGTHS, sequences

from jaxreplay import Records
from jaxreplay.recordings.findings import findings_of
from jaxreplay.recordings.inspect import columns_of, inspect, table_of


def findings(sensors, commands):
    found = inspect(Records.from_sequences(sensors, commands)).findings
    return [(f.text, f.records, f.column, f.at) for f in found]


def with_sensors(*more):
    """Ordinary records with more sensors, each given by a function of the record and its rows."""
    sensors, commands = sequences()
    for i, z in enumerate(sensors):
        added = [one(i, np.arange(len(z)))[:, None] for one in more]
        sensors[i] = np.hstack([z, *added])
    return sensors, commands


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_records_that_end_in_motion_are_found(scale):
    sensors, commands = sequences(scale=scale)
    for rows in (sensors, commands):
        rows[1], rows[4] = rows[1][:-12], rows[4][:-12]
    ((text, which, column, at),) = findings(sensors, commands)
    assert (which, column, at) == ((1, 4), None, None)
    assert text.startswith("records 1, 4: still in motion at the end (sensor z0); a replay ends")
    for rows in (sensors, commands):
        rows[:] = [rows[1], rows[4]]
    ((text, which, *_),) = findings(sensors, commands)
    assert which == ()
    assert text.startswith("every record: still in motion")


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_noise_at_the_end_is_no_motion(seed):
    rng = np.random.default_rng(seed)
    path = np.concatenate([np.linspace(0, 1, 60), np.ones(10)])
    sensors = [(path + 0.01 * rng.normal(size=70))[:, None] for _ in range(4)]
    assert findings(sensors, [np.cos(3 * path)[:, None]] * 4) == []


@pytest.mark.parametrize("turn", [2 * np.pi, 360.0])
def test_an_angle_that_wraps_is_found_and_its_jumps_are_not_named_twice(turn):
    def angle(i, t):
        end = 0.9 if i in (1, 3) else 0.3  # turns
        turned = np.minimum(t / (len(t) - 12), 1) * end + 1e-3 * (-1.0) ** t
        return turn * ((turned + 0.5) % 1 - 0.5)

    ((text, which, column, at),) = findings(*with_sensors(angle))
    assert (which, column) == ((1, 3), 3)
    assert at[0] == 1
    assert "an angle that wraps" in text
    assert "record its cosine and sine instead" in text


def test_switches_and_drops_to_nothing_are_no_angles():
    def switch(i, t):
        return np.where(t > 50, 360.0, 0.0)

    def distance(i, t):  # seen until it is beyond the range
        return np.where(t < 60, 6.28 * t / 60 + 0.3, 0)

    assert findings(*with_sensors(switch, distance)) == []


def quaternion(i, t):
    """A turn about a tilted axis, that comes to rest."""
    half = 0.4 + np.minimum(t / (len(t) - 12), 1) * (0.5 + i / 50)
    axis = np.array([0.6, 0.64, 0.48])
    return np.column_stack([np.cos(half), np.sin(half)[:, None] * axis])


def test_signs_that_flip_together_are_found():
    sensors, commands = sequences()
    for i, z in enumerate(sensors):
        q = quaternion(i, np.arange(len(z)))
        if i == 2:
            q[40:70] *= -1
        sensors[i] = np.hstack([z, q])
    ((text, which, column, at),) = findings(sensors, commands)
    assert (which, column, at) == ((2,), 3, (2, 40))
    assert text.startswith(
        "sensors z3, z4, z5, z6 change sign together at record 2, row 40 (1 more; record 2)"
    )
    sensors[2][40:70, 3:] *= -1
    assert findings(sensors, commands) == []


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_noise_around_zero_does_not_flip(seed):
    rng = np.random.default_rng(seed)
    sensors, commands = sequences()
    sensors = [np.hstack([z, rng.normal(size=(len(z), 6))]) for z in sensors]
    assert not any("change sign" in text for text, *_ in findings(sensors, commands))


@pytest.mark.parametrize("n", [1, 6])
def test_a_spike_in_a_command_is_found_but_not_a_step(n):
    sensors, commands = sequences(LENGTHS[:n])
    commands[n - 1][20:22, 0] += 3
    ((text, which, column, at),) = findings(sensors, commands)
    assert (which, column, at) == ((n - 1,), 3, (n - 1, 20))
    assert text.startswith("command u0 has a spike of")
    commands[n - 1][22:, 0] += 3
    assert findings(sensors, commands) == []


def test_a_clock_is_found():
    rng = np.random.default_rng(0)

    def clock(i, t):
        return 1000.0 * i + 0.1 * t

    def share(i, t):
        return t / len(t)

    found = findings(*with_sensors(clock, share))
    assert all("as a clock does" in f[0] for f in found)  # and no end in motion
    assert [f[1:3] for f in found] == [((), 3), ((), 4)]

    def once_at_rest(i, t):
        return np.minimum(0.1 * t, 8 if i == 3 else 100.0)

    def unsteady(i, t):
        return np.cumsum(rng.random(len(t)))

    def own_pace(i, t):
        return t * (1 + i)

    found = findings(*with_sensors(once_at_rest, unsteady, own_pace))
    assert not any("as a clock does" in f[0] for f in found)


def nan_findings(rows):
    columns = columns_of(rows, ("z0", "z1", "z2"), ("u0", "u1"))
    return columns, list(findings_of(rows, columns))


def test_values_that_are_not_measured_are_counted_and_hide_nothing():
    sensors, commands = sequences()
    sensors[4][60:, 0] += 5
    rows = table_of(Records.from_sequences(sensors, commands))
    rows[1][10:25, 1] = rows[3][0, 1] = rows[0][-3:, 1] = np.nan
    columns, found = nan_findings(rows)
    assert [c.missing for c in columns] == [0, 19, 0, 0, 0]
    assert np.isfinite([c[2:7] for c in columns]).all()
    assert [(f.column, f.records) for f in found] == [(0, (4,)), (1, (0, 1, 3))]
    assert found[1].text.startswith(
        "sensor z1 is not measured in 19 of 610 rows (3.1%; records 0 (3), 1 (15), 3 (1))"
    )
    for r in rows:
        r[:, 1] = np.nan
    columns, found = nan_findings(rows)
    assert np.isnan(columns[1][2:7:2]).all()
    assert found[1].text == "sensor z1 is not measured in any of 610 rows: leave it out"


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.5, 0.99, 1.0]))
def test_nothing_else_is_found_where_much_is_missing(seed, share):
    rng = np.random.default_rng(seed)
    rows = table_of(Records.from_sequences(*sequences((40, 45, 9, 1))))
    for r in rows:
        r[:, :3][rng.random((len(r), 3)) < share] = np.nan
    nan_findings(rows)  # without a warning, which would be an error


def test_a_copy_with_the_same_gaps_is_found():
    rows = table_of(Records.from_sequences(*sequences()))
    rows[0][20:30, 1] = np.nan
    rows.append(rows[0].copy())
    assert [f.records for f in nan_findings(rows)[1]] == [(0, 6), (0, 6)]
    rows[6][25, 1] = 0
    assert [f.records for f in nan_findings(rows)[1]] == [(0, 6)]  # not measured
