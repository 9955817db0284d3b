"""What a user may give as demonstrations, and the message for what not."""

import h5py
import numpy as np
import pandas as pd
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxreplay import Records
from jaxreplay.records.given import numbers, one_for_each

U = [np.ones((3, 1))] * 2


def only(sensors, **names):
    """The sensors of records, and their names."""
    records = Records.from_sequences(sensors, [np.ones((len(s), 1)) for s in sensors], **names)
    return records.sequences()[0], records.sensor_names


@pytest.mark.parametrize("frame", [pd.DataFrame, pl.DataFrame])
def test_frames_are_taken_by_the_names_of_their_columns(frame):
    frames = [frame({"x": [1, 2], "on": [True, False]}), frame({"on": [False], "x": [3.5]})]
    sensors, names = only(frames)
    assert names == ("x", "on")
    assert [s.tolist() for s in sensors] == [[[1, 1], [2, 0]], [[3.5, 0]]]
    sensors, names = only(frames, sensor_names=["on", "x"])
    assert names == ("on", "x")
    assert [s.tolist() for s in sensors] == [[[1, 1], [0, 2]], [[0, 3.5]]]


@pytest.mark.parametrize(
    "column",
    [
        pd.DataFrame({"x": pd.array([1, None], dtype="Int64")}),
        pd.DataFrame({"x": pd.array([True, None], dtype="boolean")}),
        pl.DataFrame({"x": [1, None]}),
        pl.DataFrame({"x": [True, None]}),
        np.ma.masked_greater(np.array([[1], [10**6]]), 5),
        [np.ma.array([1]), np.ma.array([1.0], mask=True)],
        np.array([[1], [None]], object),
    ],
    ids=str,
)
def test_what_is_masked_or_missing_becomes_nan(column):
    (array,), _ = one_for_each([column], "sensors")
    np.testing.assert_array_equal(numbers(array, "here"), [[1], [np.nan]])
    with pytest.raises(ValueError, match=r"record 0: commands\[1, 0\] is nan"):
        Records.from_sequences([np.ones((2, 1))], [column])


def test_bools_and_one_array_of_all_records():
    sensors, _ = only([np.array([[True], [False]])])
    assert sensors[0].tolist() == [[1], [0]]
    cube = np.arange(12.0).reshape(2, 3, 2)
    sensors, _ = only(cube)
    np.testing.assert_array_equal(sensors, cube)


def test_a_dataset_of_hdf5_is_an_array(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = [[1.0], [2.0]]
        sensors, _ = only([file["x"]])
    assert sensors[0].tolist() == [[1], [2]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.ones((3, 2)), r"sensors is one array of shape \(3, 2\); wrap it in a list: \[sensors"),
        (np.ones(3), r"sensors is an array of shape \(3,\); pass a list with one array"),
        (pd.DataFrame({"x": [1]}), "sensors is one data frame, not a list; wrap it in a list"),
        ({"a": np.ones((3, 1))}, r"sensors is a dict; pass a list .* list\(sensors\.values\(\)\)"),
        ("demos.csv", r"sensors is 'demos\.csv'; .*jr\.read reads a file"),
        (None, "sensors is None; pass a list"),
        ([{"x": np.ones(3)}] * 2, r"record 0: sensors is a dict; .*np\.column_stack.*'x'"),
        ([np.array([["a"]])] * 2, "record 0: sensors is not an array of numbers: .*text"),
        ([np.array([["1"]], object)] * 2, "record 0: sensors is not .*: it contains text, '1'"),
        ([np.zeros((3, 1), "M8[s]")] * 2, "record 0: sensors .*contains dates; convert them to s"),
        ([np.zeros((3, 1), "m8[s]")] * 2, r"record 0: sensors .*time differences.*timedelta64"),
        ([np.zeros((3, 1), complex)] * 2, "record 0: sensors .*complex numbers; pass real and"),
        ([np.zeros(3, [("x", float)])] * 2, "record 0: sensors .*named fields"),
        (
            [pd.Series([np.ones(2), np.ones(2)]).to_numpy()] * 2,
            r"record 0: sensors is a column of arrays, not one array; stack them: np\.stack",
        ),
        (
            [pd.DataFrame({"s": [np.ones(2)] * 3})] * 2,
            r"record 0: sensors, column s, is a column of arrays.* np\.stack",
        ),
        (
            [pd.DataFrame({"t": pd.to_datetime(["2024-01-01"])})] * 2,
            "record 0: sensors, column t, is not an array of numbers: it contains dates",
        ),
        (
            [pl.DataFrame({"name": ["a"]})] * 2,
            "record 0: sensors, column name, is not .* contains text, 'a'",
        ),
        (
            [pd.DataFrame({"x": [1]}), pd.DataFrame({"y": [1]})],
            "record 1: sensors has the columns y; record 0 has x; pick the same",
        ),
        (
            [pd.DataFrame({"x": [1]}), np.ones((1, 1))],
            "record 1: sensors has no column names, but record 0 is a data frame",
        ),
    ],
)
def test_a_mistake_says_what_to_pass(given, message):
    with pytest.raises(ValueError, match=message) as raised:
        Records.from_sequences(given, U)
    assert "\n" not in str(raised.value)
    with pytest.raises(ValueError, match=message.replace("sensors", "observations")):
        Records.from_steps(given, U)


def test_names_that_are_not_those_of_frames_are_refused():
    frames = [pd.DataFrame({"x": [1], "y": [2]})]
    with pytest.raises(ValueError, match=r"the columns x, y; the names given are x, z; pick"):
        only(frames, sensor_names=["x", "z"])


def test_a_group_of_hdf5_is_named_by_its_path(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data/demo_0/x"] = [[1.0]]
        group = file["data/demo_0"]
        with pytest.raises(ValueError, match=r"sensors is the HDF5 group /data/demo_0; pass a li"):
            Records.from_sequences(group, U)
        with pytest.raises(ValueError, match=r"record 0: .* /data/demo_0; .*one of: 'x'"):
            Records.from_sequences([group], U[:1])


def test_rows_of_steps_by_hand():
    """Three observations stand beside, or around, two actions."""
    for sent in ([[1], [2]], [[1], [2], [3]]):
        records = Records.from_steps([[[10], [20], [30]]], [sent], ["x"], ["u"], 0.5)
        (sensors,), (commands,) = records.sequences()
        assert sensors.tolist() == [[20], [30]]
        assert commands.tolist() == [[1], [2]]
        assert (records.sensor_names, records.command_names) == (("x",), ("u",))
        assert records.period == 0.5


@given(st.lists(st.tuples(st.integers(2, 9), st.booleans()), min_size=1, max_size=4))
def test_each_row_is_an_action_and_the_observation_after_it(episodes):
    seen = [np.arange(n)[:, None] + 100.0 * i for i, (n, _) in enumerate(episodes)]
    sent = [s[:-1] if extra else s for s, (_, extra) in zip(seen, episodes, strict=True)]
    sensors, commands = Records.from_steps(seen, sent).sequences()
    for z, u, (n, _) in zip(sensors, commands, episodes, strict=True):
        assert len(z) == len(u) == n - 1
        np.testing.assert_array_equal(z, u + 1)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ((5, 3), "record 0: 5 observations but 3 actions; give one observation more"),
        ((3, 4), "record 0: 3 observations but 4 actions"),
        ((1, 1), "record 0: 1 observation and 1 action leave no row.*at least 2 observations"),
        ((1, 0), r"record 0: actions must have shape .* got \(0, 1\)"),
    ],
)
def test_steps_that_leave_no_rows_or_do_not_pair_up_are_refused(rows, message):
    with pytest.raises(ValueError, match=message):
        Records.from_steps(*([np.ones((n, 1))] for n in rows))
    with pytest.raises(ValueError, match="1 episodes of observations but 2 of actions"):
        Records.from_steps(U[:1], U)
