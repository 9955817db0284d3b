"""Bytes that change on a disk: never a traceback, and never another number without a word."""

import warnings

import numpy as np
import pytest
import xarray as xr
from study_helpers import made_up_study, some_records, write

import jaxreplay as jr
from jaxreplay import cli

TEXT = "theta_i = 0.01\nslots = 4\n[axis]\njump = ['own_tau', 'same_tau']"
HOW_MANY = [25, pytest.param(1500, marks=pytest.mark.slow)]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A folder, and its dataset."""
    folder = tmp_path_factory.mktemp("study")
    made_up_study(write(folder, TEXT), folder)
    return folder, jr.open_study(folder)


def spoilt(content, rng):
    """The bytes with one bit changed, one byte changed, or without an end."""
    at, kind = int(rng.integers(len(content))), rng.integers(3)
    if kind == 0:
        return content[:at]
    byte = content[at] ^ (1 << rng.integers(8)) if kind == 1 else int(rng.integers(256))
    return content[:at] + bytes([byte]) + content[at + 1 :]


def tried(call):
    """What a call returns, or the message of its ValueError."""
    try:
        return call(), None
    except ValueError as error:
        return None, str(error)


def read_again(folder, before):
    """Open a study; return the warnings, once what it has is what it had before."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        after = jr.open_study(folder)
    left = (after.outcome != "").values
    for name in before.data_vars:
        np.testing.assert_array_equal(after[name].values[left], before[name].values[left])
    assert not told if left.all() else len(told) == 1
    return told


@pytest.mark.parametrize("n", HOW_MANY)
def test_no_change_of_a_manifest_shows_other_numbers(study, n):
    folder, before = study
    path = folder / "study.json"
    content, rng, refused = path.read_bytes(), np.random.default_rng(n), 0
    changes = [spoilt(content, rng) for _ in range(n)]
    if n > 100:  # every byte
        changes += [content[:k] + bytes([c ^ 1]) + content[k + 1 :] for k, c in enumerate(content)]
    try:
        for changed in changes:
            path.write_bytes(changed)
            _, message = tried(lambda: read_again(folder, before))
            refused += message is not None
            assert message is None or ("study.json" in message and "\n" not in message)
    finally:
        path.write_bytes(content)
    assert refused > n / 2  # of the others most are in the versions of libraries


@pytest.mark.parametrize("n", HOW_MANY)
def test_no_change_of_a_shard_shows_other_numbers(study, n):
    folder, before = study
    path = folder / "shards" / "00000.nc"
    content, rng = path.read_bytes(), np.random.default_rng(n + 1)
    told = 0
    try:
        for _ in range(n):
            path.write_bytes(spoilt(content, rng))
            told += len(read_again(folder, before))
    finally:
        path.write_bytes(content)
    assert told > n / 2


@pytest.mark.parametrize("n", HOW_MANY)
def test_no_change_of_records_gives_other_records(tmp_path, n):
    path = tmp_path / "records.npz"
    some_records(4).save(path)
    before, content, rng = jr.Records.load(path), path.read_bytes(), np.random.default_rng(n + 2)
    refused = 0
    for _ in range(n):
        path.write_bytes(spoilt(content, rng))
        after, message = tried(lambda: jr.read(path))
        if after is None:
            refused += 1
            assert "records.npz" in message
            assert "\n" not in message
            continue
        for name in ("nodes", "commands", "lengths", "offset"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
        assert after.sensor_names == before.sensor_names
    assert refused > n / 2


@pytest.mark.parametrize(
    ("old", "new"), [('"repeats": 3', '"repeats": 1'), ('"shard": 56', '"shard": 28')]
)
def test_a_manifest_that_was_edited_is_refused(study, capsys, old, new):
    folder, _ = study
    path = folder / "study.json"
    content = path.read_text()
    assert old in content
    try:
        path.write_text(content.replace(old, new))
        for command in ("show", "plot", "watch"):
            assert cli.main([command, str(folder)]) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert "study.json is damaged or was edited" in line
    finally:
        path.write_text(content)


def test_shards_in_each_others_place_are_left_out_and_named(tmp_path, capsys):
    """As a copy of one over another: its values would be those of other runs."""
    made_up_study(write(tmp_path, TEXT), tmp_path)
    before = jr.open_study(tmp_path)
    first, second = (tmp_path / "shards" / f"0000{k}.nc" for k in (0, 1))
    first.write_bytes(second.read_bytes())
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert cli.main(["show", str(tmp_path)]) == 0
    told = capsys.readouterr().err
    assert "00000.nc is damaged, or another shard: it does not fit its checksum; left out" in told
    assert "15 of 30 runs are missing" in told
    with pytest.warns(UserWarning, match="left out"):
        after = jr.open_study(tmp_path)
    xr.testing.assert_identical(after.outcome.isel(jump=1), before.outcome.isel(jump=1))
    assert (after.outcome.isel(jump=0) == "").all()
