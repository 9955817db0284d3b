import io
import pickle
import zipfile

import jax
import numpy as np
import pytest
from random_helpers import random_sequences

from jaxreplay import Records

LENGTHS = (5, 3, 2, 1)
NAMES = {"sensor_names": ("x", "größe"), "command_names": ("left", "right"), "period": 0.25}


@pytest.fixture
def records():
    return Records.from_sequences(*random_sequences(0, LENGTHS), **NAMES)


def assert_same(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)  # names and period
    for mine, other in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert mine.dtype == other.dtype
        np.testing.assert_array_equal(mine, other)


def changed(records, **parts):
    """The contents of a records file, with parts changed; a part that is None is left out."""
    sensors, commands = records.sequences()
    whole = {
        "sensors": np.concatenate(sensors),
        "commands": np.concatenate(commands),
        "lengths": np.asarray(records.lengths),
        "sensor_names": np.array(records.sensor_names),
        "command_names": np.array(records.command_names),
        "period": np.array(records.period),
    }
    return {name: part for name, part in (whole | parts).items() if part is not None}


def test_sequences_gives_back_what_from_sequences_took(records):
    for taken, back in zip(random_sequences(0, LENGTHS), records.sequences(), strict=True):
        for a, b in zip(taken, back, strict=True):
            np.testing.assert_array_equal(a, b)
    assert_same(records, Records.from_sequences(*records.sequences(), **NAMES))


def test_sizes_names_and_defaults(records):
    assert (records.n_records, records.longest) == (4, 5)
    assert (records.n_sensors, records.n_commands) == (2, 2)
    assert records.lengths.tolist() == list(LENGTHS)
    unnamed = Records.from_sequences([[[1, 2, 3]]], [[[4]]])
    assert unnamed.sensor_names == ("z0", "z1", "z2")
    assert unnamed.command_names == ("u0",)
    assert unnamed.period is None


def test_nodes_mirror_the_ends_and_commands_are_zero_past_them():
    column = [[[1], [2], [4]], [[5], [7]], [[9]]]
    records = Records.from_sequences(column, column)
    assert records.nodes[0].tolist() == [[2, 1, 2, 4, 2], [7, 5, 7, 5, 5], [9, 9, 9, 9, 9]]
    assert records.commands[0].tolist() == [[1, 2, 4], [5, 7, 0], [9, 0, 0]]


def test_float64_is_kept_under_x64(tmp_path):
    with jax.enable_x64(True):
        records = Records.from_sequences([[[0.1]]], [[[0.2]]])
        assert records.nodes.dtype == records.commands.dtype == "float64"
        records.save(tmp_path / "r.npz")
        assert_same(records, Records.load(tmp_path / "r.npz"))


def test_subset_takes_records_in_the_given_order(records):
    sensors, commands = random_sequences(0, LENGTHS)
    which = [3, 1, 1]
    picked = records.subset(which)
    for found, wanted in zip(picked.sequences(), (sensors, commands), strict=True):
        for rows, i in zip(found, which, strict=True):
            np.testing.assert_array_equal(rows, wanted[i])
    seen = np.concatenate([sensors[i] for i in which])
    np.testing.assert_array_equal(picked.span, [seen.min(0), seen.max(0)])
    assert picked.longest == records.longest  # what was compiled for three records is reused
    assert_same(records.subset(range(4)), records)


@pytest.mark.parametrize("which", [[0, 4], [-1]])
def test_subset_of_an_unknown_record_is_an_error(records, which):
    with pytest.raises(ValueError, match=f"no record {which[-1]}: there are 4"):
        records.subset(which)


def test_empty_subset_is_an_error(records):
    with pytest.raises(ValueError, match="at least one"):
        records.subset([])


@pytest.mark.parametrize("period", [0.25, None])
@pytest.mark.parametrize("name", ["records.npz", "no_suffix"])
def test_load_reads_what_save_wrote(tmp_path, name, period):
    records = Records.from_sequences(*random_sequences(0, LENGTHS), **NAMES | {"period": period})
    records.save(tmp_path / name)
    assert_same(records, Records.load(tmp_path / name))
    assert_same(records, Records.load(str(tmp_path / name)))
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_interrupted_save_leaves_the_old_file(tmp_path, records, monkeypatch):
    def interrupted(file, **_):
        file.write(b"half")
        raise KeyboardInterrupt

    path = tmp_path / "records.npz"
    records.save(path)
    monkeypatch.setattr(np, "savez_compressed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        records.subset([0]).save(path)
    assert_same(records, Records.load(path))


def test_the_file_contains_no_pickles(tmp_path, records):
    path = tmp_path / "records.npz"
    records.save(path)
    with np.load(path, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)


def test_pickles_are_not_loaded(tmp_path, records):
    opened = tmp_path / "opened"

    class Harmful:
        def __reduce__(self):
            return opened.touch, ()

    path = tmp_path / "records.npz"
    np.savez(path, **changed(records, sensor_names=np.array([Harmful()], object)))
    with pytest.raises(ValueError, match=r"records\.npz does not contain records"):
        Records.load(path)
    path.write_bytes(pickle.dumps(Harmful()))
    with pytest.raises(ValueError, match=r"records\.npz does not contain records"):
        Records.load(path)
    assert not opened.exists()


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no records file .*absent\.npz"):
        Records.load(tmp_path / "absent.npz")


def test_a_folder_is_not_reported_as_a_damaged_file(tmp_path):
    with pytest.raises(IsADirectoryError):
        Records.load(tmp_path)


def test_truncated_file_is_an_error_wherever_it_was_cut(tmp_path, records):
    path = tmp_path / "records.npz"
    records.save(path)
    whole = path.read_bytes()
    for size in [*range(0, len(whole), 50), len(whole) - 1]:
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match=r"records\.npz does not contain records \(truncated"):
            Records.load(path)


def test_damaged_numbers_are_an_error_whichever_byte_changed(tmp_path, records):
    path = tmp_path / "records.npz"
    records.save(path)
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as file:
        first = file.getinfo("sensors.npy")
    begin = first.header_offset + 30 + len("sensors.npy") + 20  # past the header and its extras
    for at in range(begin, first.header_offset + first.compress_size):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        with pytest.raises(ValueError, match="does not contain records"):
            Records.load(path)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"sensors": None}, "does not contain records"),
        ({"period": None}, "does not contain records"),
        ({"lengths": np.array(["a", "b", "c", "d"])}, "does not contain records"),
        ({"lengths": np.array([5, 3, 2, 2])}, "does not contain records"),
        ({"lengths": np.array([5, 3, 2])}, "does not contain records"),
        ({"lengths": np.array([5, 3, -2, 5])}, "does not contain records"),
        ({"sensors": np.zeros(11)}, "does not contain records"),
        ({"sensors": np.full((11, 2), np.nan)}, r": record 0: x is NaN in all"),
        ({"commands": np.zeros((10, 2))}, "does not contain records"),
        ({"sensor_names": np.array("x")}, "does not contain records"),
        ({"sensor_names": np.array(["x"])}, ": 2 distinct sensor names are needed"),
        ({"period": np.array(-1.0)}, ": period must be a positive number"),
        ({"period": np.array([0.1, 0.2])}, "does not contain records"),
    ],
    ids=str,
)
def test_foreign_or_inconsistent_file_is_an_error(tmp_path, records, parts, message):
    np.savez(tmp_path / "records.npz", **changed(records, **parts))
    with pytest.raises(ValueError, match=rf"records\.npz ?{message}"):
        Records.load(tmp_path / "records.npz")


def test_a_file_that_claims_too_much_is_refused_before_memory_is_taken(
    tmp_path, records, monkeypatch
):
    """A header of terabytes, and arrays that unpack to more than may be read."""
    path = tmp_path / "records.npz"
    records.save(path)
    with zipfile.ZipFile(path) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    claims = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 2)}
    np.lib.format.write_array_header_1_0(claims, header)
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as file:
        for name, part in parts.items():
            file.writestr(name, claims.getvalue() if name == "sensors.npy" else part)
    with pytest.raises(ValueError, match=r"sensors is float64 \(1000000000000, 2\), not of its"):
        Records.load(tmp_path / "huge.npz")
    monkeypatch.setattr("jaxreplay.records.file.LARGEST", 100)
    with pytest.raises(ValueError, match=r"its arrays take .* GiB; up to 2 can be read"):
        Records.load(path)


@pytest.mark.parametrize("content", [b"", b"x,y\n1,2\n", b"PK\x03\x04"])
def test_file_of_another_kind_is_an_error(tmp_path, content):
    path = tmp_path / "other.csv"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"other\.csv does not contain records"):
        Records.load(path)


def test_npy_file_is_an_error(tmp_path):
    np.save(tmp_path / "other.npy", np.zeros(3))
    with pytest.raises(ValueError, match=r"other\.npy does not contain records"):
        Records.load(tmp_path / "other.npy")


def with_value(value):
    rows = np.ones((3, 2))
    rows[2, 1] = value
    return rows


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (with_value(-np.inf), r"record 1: {}\[2, 1\] is -inf, not a finite float32"),
        (with_value(1e39), r"record 1: {}\[2, 1\] is 1e\+39, not a finite float32"),
        (np.ones(3), r"record 1: {} must have shape .*; got \(3,\)"),
        (np.ones((3, 2, 1)), r"record 1: {} must have shape .*; got \(3, 2, 1\)"),
        (np.ones((0, 2)), r"record 1: {} must have shape .* at least 1; got \(0, 2\)"),
        (np.ones((3, 0)), r"record 1: {} must have shape .* at least 1; got \(3, 0\)"),
        (np.ones((3, 1)), r"record 1: {} has 1 columns, record 0 has 2"),
        ([[1, 2], [3]], r"record 1: {} is not an array of numbers"),
        ([["a", "b"]], r"record 1: {} is not an array of numbers"),
        (None, r"record 1: {} must have shape"),
    ],
)
@pytest.mark.parametrize("kind", ["sensors", "commands"])
def test_bad_rows_are_named_with_their_record(kind, second, message):
    sequences = {"sensors": [np.ones((3, 2))] * 2, "commands": [np.ones((3, 2))] * 2}
    sequences[kind] = [np.ones((3, 2)), second]
    with pytest.raises(ValueError, match=message.format(kind)):
        Records.from_sequences(**sequences)


def test_rows_that_do_not_pair_up_are_an_error():
    one, longer = np.ones((3, 2)), np.ones((4, 2))
    with pytest.raises(ValueError, match=r"record 1: 4 sensor rows but 3 command rows"):
        Records.from_sequences([one, longer], [one, one])
    with pytest.raises(ValueError, match="2 sensor sequences but 1 command sequences"):
        Records.from_sequences([one, one], [one])
    with pytest.raises(ValueError, match="at least one demonstration; got none"):
        Records.from_sequences([], [])


@pytest.mark.parametrize("names", [["a"], ["a", "b", "c"], ["a", "a"], []])
def test_names_must_be_distinct_and_one_for_each_column(names):
    one = [np.ones((3, 2))]
    with pytest.raises(ValueError, match="2 distinct sensor names"):
        Records.from_sequences(one, one, sensor_names=names)
    with pytest.raises(ValueError, match="2 distinct command names"):
        Records.from_sequences(one, one, command_names=names)


@pytest.mark.parametrize("period", [0, -0.1, np.nan, np.inf])
def test_period_must_be_a_positive_time(period):
    one = [np.ones((3, 2))]
    with pytest.raises(ValueError, match="period must be a positive number"):
        Records.from_sequences(one, one, period=period)


def test_records_are_a_pytree_of_arrays(records):
    leaves, structure = jax.tree.flatten(records)
    listed = [leaf.shape for leaf in records.long]
    assert [leaf.shape for leaf in leaves] == [(2, 4, 7), (2, 4, 5), (4,), (2, 2), *listed]
    assert_same(records, jax.tree.unflatten(structure, leaves))
    assert jax.tree.map(lambda _: None, records).sensor_names == records.sensor_names


def test_records_pass_through_jit(records):
    doubled = jax.jit(lambda r: jax.tree.map(lambda leaf: 2 * leaf, r))(records)
    assert_same(doubled, jax.tree.map(lambda leaf: 2 * leaf, records))
    assert doubled.longest == records.longest


def test_its_repr_is_one_line():
    records = Records.from_sequences(*random_sequences())
    assert repr(records) == (
        "Records of 4 demonstrations of up to 200 samples; sensors z0, z1; commands u0, u1"
    )
