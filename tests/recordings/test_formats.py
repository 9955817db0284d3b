"""From a file in each public layout to the values in the records."""

import json
import re
import sys

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import jaxreplay as jr
from jaxreplay import cli
from jaxreplay.errors import ConfigError

CSV = "t,x,phi,u,note\n0,1,0,5,a\n0.1,2,1.5,6,b\n0.2,4,3,7,c\n"


def rows(records):
    """The values of all records, as lists."""
    sensors, commands = records.sequences()
    return [s.tolist() for s in sensors], [c.tolist() for c in commands]


def lerobot(folder, lengths=(3, 4), fps=10, names=("a", "b"), skip=None):
    """A LeRobot v3 dataset: state (t, 10 t), action 100 t, of as many rows as the lengths."""
    episode = np.repeat(np.arange(len(lengths)), lengths)
    frame = np.concatenate([np.arange(n) for n in lengths])
    keep = np.arange(len(frame)) != skip
    episode, frame = episode[keep], frame[keep]
    state = np.stack([frame, 10 * frame], 1).astype(np.float32)
    table = pa.table(
        {
            "observation.state": pa.FixedSizeListArray.from_arrays(state.ravel(), 2),
            "action": pa.FixedSizeListArray.from_arrays((100 * frame).astype(np.float32), 1),
            "timestamp": (frame / fps).astype(np.float32),
            "frame_index": frame,
            "episode_index": episode,
            "task": ["pick"] * len(frame),
        }
    )
    path = folder / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    pq.write_table(table, path)
    (folder / "meta").mkdir()
    features = {"observation.state": {"dtype": "float32", "shape": [2], "names": names}}
    info = {"codebase_version": "v3.0", "fps": fps, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return path


def robomimic(path, numbers=(0, 2, 10), rate=20):
    """A robomimic file: each demonstration has its own number in x."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_kwargs": {"control_freq": rate}})
        for n in numbers:
            demo = data.create_group(f"demo_{n}")
            demo["actions"] = np.array([[1.0, 2], [3, 4], [5, 6]])
            demo["obs/eef"] = np.array([[n, 0.0], [n, 1], [n, 2]])
            demo["obs/grip"] = np.array([7.0, 8, 9])
            demo["obs/image"] = np.zeros((3, 2, 2, 3), np.uint8)
            demo["dones"] = np.array([0, 0, 1])
    return path


def minari(path, group=False):
    """A Minari file: four observations of three actions."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        for n in range(2):
            name = f"episode_{n}/observations" + ("/pole/angle" if group else "")
            file[name] = np.array([[0.0], [1], [2], [3]]) + 10 * n
            file[f"episode_{n}/actions"] = np.array([5, 6, 7])
            file[f"episode_{n}/rewards"] = np.zeros(3)
    return path


def test_csv(tmp_path):
    for name in ("demo2.csv", "demo10.csv"):
        (tmp_path / name).write_text(CSV.replace("1,0,5", f"{name[4:-4]},0,5"))
    records = jr.read(tmp_path / "demo2.csv", ["x"], ["u"], time="t")
    assert rows(records) == ([[[2], [2], [4]]], [[[5], [6], [7]]])
    assert (records.sensor_names, records.command_names, records.period) == (("x",), ("u",), 0.1)
    every = [tmp_path / "demo2.csv", str(tmp_path / "demo10.csv")]
    for many in (tmp_path, str(tmp_path / "*.csv"), every):
        assert [s[0] for s in rows(jr.read(many, "x", "u"))[0]] == [[2], [10]]
    before = jr.read(tmp_path / "demo2.csv", "x", "u", period=0.5, observed="before")
    assert rows(before) == ([[[2], [4]]], [[[5], [6]]])
    assert before.period == 0.5


def test_columns_of_files_are_taken_by_name(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,u\n1,2,3\n")
    (tmp_path / "b.csv").write_text("u,y,x\n6,5,4\n")
    records = jr.read(tmp_path, ["y", "x"], ["u"])
    assert rows(records) == ([[[2, 1]], [[5, 4]]], [[[3]], [[6]]])


def test_csv_with_a_column_of_episodes(tmp_path):
    path = tmp_path / "all.csv"
    path.write_text("run,x,u\nb,1,True\nb,2,false\n\na,3,1\nb,4,0\n", encoding="utf-8-sig")
    assert rows(jr.read(path, ["x"], ["u"], episode="run")) == (
        [[[1], [2], [4]], [[3]]],
        [[[1], [0], [0]], [[1]]],
    )


def test_angles_become_cosine_and_sine(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(CSV)
    records = jr.read(path, ["phi", "x"], ["u"], angles=["phi"])
    assert records.sensor_names == ("cos(phi)", "sin(phi)", "x")
    phi = np.array([0, 1.5, 3])
    want = np.stack([np.cos(phi), np.sin(phi), [1, 2, 4]], 1)
    np.testing.assert_allclose(records.sequences()[0][0], want, rtol=1e-6)


def test_lerobot(tmp_path):
    path = lerobot(tmp_path)
    for given in (tmp_path, path):
        records = jr.read(given)
        assert records.sensor_names == ("a", "b")
        assert records.command_names == ("action[0]",)
        assert records.period == 0.1
        assert rows(records) == (
            [[[1, 10], [2, 20]], [[1, 10], [2, 20], [3, 30]]],
            [[[0], [100]], [[0], [100], [200]]],
        )
    for name in ("b", "observation.state[1]"):
        picked = jr.read(tmp_path, [name], ["action"])
        assert picked.sensor_names == ("b",)
        assert rows(picked)[0][0] == [[10], [20]]
    assert jr.read(tmp_path, "observation.state").sensor_names == ("a", "b")
    assert rows(jr.read(tmp_path, observed="after"))[1][0] == [[0], [100], [200]]


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (None, ("observation.state[0]", "observation.state[1]")),
        (["motors"], ("observation.state[0]", "observation.state[1]")),
        ({"motors": ["p", "q"]}, ("p", "q")),
    ],
)
def test_names_that_lerobot_datasets_give(tmp_path, names, found):
    lerobot(tmp_path, names=names)
    assert jr.read(tmp_path).sensor_names == found


def test_parquet_of_other_columns(tmp_path):
    path = tmp_path / "mine.parquet"
    table = pa.table({"x": [1, 2, 3], "v": [[1.0, 2], [3, 4], [5, 6]], "u": [4.0, 5, 6]})
    pq.write_table(table, path)
    records = jr.read(path, ["v", "x"], ["u"])
    assert records.sensor_names == ("v[0]", "v[1]", "x")
    assert rows(records) == ([[[3, 4, 2], [5, 6, 3]]], [[[4], [5]]])
    with pytest.raises(ConfigError, match=r"give its sensors by name; its columns are x, v, u"):
        jr.read(path)


def test_robomimic(tmp_path):
    records = jr.read(robomimic(tmp_path / "low_dim.hdf5"))
    assert records.sensor_names == ("eef[0]", "eef[1]", "grip")
    assert records.command_names == ("actions[0]", "actions[1]")
    assert records.period == 0.05
    sensors, commands = rows(records)
    assert sensors == [[[n, 1, 8], [n, 2, 9]] for n in (0, 2, 10)]
    assert commands == [[[1, 2], [3, 4]]] * 3
    picked = jr.read(tmp_path / "low_dim.hdf5", ["grip", "dones"], ["actions[1]"])
    assert rows(picked.subset([0])) == ([[[8, 0], [9, 1]]], [[[2], [4]]])


@pytest.mark.parametrize("group", [False, True])
def test_minari(tmp_path, group):
    path = minari(tmp_path / "data" / "main_data.hdf5", group)
    for given in (path, tmp_path):
        records = jr.read(given)
        assert records.sensor_names == (("pole/angle[0]" if group else "observations[0]"),)
        assert records.command_names == ("actions",)
        assert rows(records) == (
            [[[1], [2], [3]], [[11], [12], [13]]],
            [[[5], [6], [7]]] * 2,
        )


def test_npz(tmp_path):
    path = tmp_path / "r.npz"
    sensors = [np.array([[1.0, 2], [3, 4]])]
    jr.Records.from_sequences(sensors, [[[5], [6]]], ["x", "y"], ["u"], 0.1).save(path)
    whole = jr.read(path)
    assert rows(whole) == ([[[1, 2], [3, 4]]], [[[5], [6]]])
    picked = jr.read([path, path], ["y"])
    assert (picked.sensor_names, picked.command_names, picked.period) == (("y",), ("u",), 0.1)
    assert rows(picked) == ([[[2], [4]]] * 2, [[[5], [6]]] * 2)


def test_episodes_of_another_rate_are_resampled(tmp_path):
    (tmp_path / "a.csv").write_text("t,x,u\n0,0,1\n0.1,1,2\n0.2,2,3\n")
    (tmp_path / "b.csv").write_text("t,x,u\n5,0,1\n5.2,4,2\n5.4,6,3\n")
    with pytest.warns(UserWarning, match=r"1 of 2 episodes resampled to 0\.1 s .*b\.csv from 0\.2"):
        records = jr.read(tmp_path, "x", "u", time="t")
    sensors, commands = rows(records)
    np.testing.assert_allclose(np.ravel(sensors[1]), [0, 0, 2, 4, 5, 6], rtol=1e-6)
    assert np.ravel(commands[1]).tolist() == [1, 1, 2, 2, 3, 3]
    assert sensors[0] == [[0], [1], [2]]


def test_uneven_times_are_resampled_if_a_period_is_given(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,x,u\n0,0,1\n0.1,1,2\n0.2,2,3\n0.5,5,4\n")
    with pytest.raises(ConfigError, match=r"a\.csv: rows 2 and 3 .* 0\.3 s apart.*give a period"):
        jr.read(path, "x", "u", time="t")
    records = jr.read(path, "x", "u", time="t", period=0.1)
    sensors, commands = rows(records)
    np.testing.assert_allclose(np.ravel(sensors), [0, 1, 2, 3, 4, 5], rtol=1e-6)
    assert np.ravel(commands).tolist() == [1, 2, 3, 3, 3, 4]


@pytest.mark.parametrize(
    ("text", "given", "message"),
    [
        (CSV, {}, "give its sensors by name; its columns are t, x, phi, u, note"),
        (CSV, {"sensors": "x"}, "give its commands by name; its columns are t,"),
        (CSV, {"sensors": "y"}, r"no sensor is named y.*\(known: t, x, phi, u, note\)"),
        (CSV, {"commands": "v"}, "no command is named v"),
        (CSV, {"sensors": ["x", "x"]}, "sensor x is named twice"),
        (CSV, {"angles": ["t"]}, r"no sensor is named t.*\(known: x\), for an angle"),
        (CSV, {"angles": ["ph"]}, "no angle is named ph; did you mean phi"),
        (CSV, {"episode": "run"}, "no column is named run"),
        (CSV, {"sensors": "note"}, r"line 2: note is 'a', not a number; choose other columns"),
        (CSV, {"period": -1.0}, "period must be a positive number of seconds; got -1"),
        (CSV, {"observed": "later"}, "observed must be 'before' or 'after'; got 'later'"),
        (CSV, {"time": "phi", "episode": "x", "observed": "before"}, "leave no row"),
        ("1,2\n3,4\n", {}, "line 1: the first line must name the columns"),
        ("", {}, "line 1: the first line must name the columns"),
        ("x,x\n3,4\n", {}, "column 'x' is named twice"),
        ("x,u\n", {}, "it has names of columns, but no rows"),
        ("x,u\n1,2\n1\n", {}, "line 3: 1 cells, but line 1 names 2 columns"),
        ("x,u\n1,\n", {}, r"a\.csv, line 2: command u is empty"),
        ("x,u,t\n1,1,0\n1,1,2\n1,1,1\n", {"time": "t"}, r"time goes from 2\.0 to 1\.0 s in rows 1"),
    ],
)
def test_a_mistake_about_a_csv_names_the_file(tmp_path, text, given, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    chosen = {"sensors": "x", "commands": "u"} if given else {}
    if not text.startswith("t,"):
        chosen = {"sensors": "x", "commands": "u"}
    if given == {"sensors": "x"}:
        chosen = {}
    with pytest.raises(ConfigError, match=message) as raised:
        jr.read(path, **chosen | given)
    assert "\n" not in str(raised.value)
    assert "a.csv" in str(raised.value) or given.keys() & {"period", "observed"}


def test_a_mistake_about_other_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refused(message, *given, **named):
        with pytest.raises(ConfigError, match=message):
            jr.read(*given, **named)

    refused(r"no file has such a name", "*.csv")
    refused("no file is given", [])
    (tmp_path / "empty").mkdir()
    refused("empty is a folder without such a file; give one with files of one format of", "empty")
    (tmp_path / "a.txt").write_text("x")
    refused(r"a\.txt does not contain records: its name must end in one of \.npz, \.csv", "a.txt")
    for name in ("a.parquet", "a.h5"):
        (tmp_path / name).write_text("not that")
    refused(r"a\.parquet: cannot be read as a Parquet file", "a.parquet")
    refused(r"a\.h5: is not a whole HDF5 file", "a.h5")
    refused(r"\. is a folder with some of \.h5, \.parquet", ".")
    refused(r"files of several formats: \.h5, \.parquet", ["a.h5", "a.parquet"])
    for name in ("no.csv", "no.parquet", "no.h5", "no.npz"):
        refused(re.escape(name), name)
    with h5py.File("other.h5", "w") as file:
        file["x"] = [1.0]
    refused(r"other\.h5: has neither data/demo_0/actions .*, but 'x'; read it with", "other.h5")
    robomimic("r.h5")
    refused(r"r\.h5: no sensor is named eff; did you mean eef", "r.h5", ["eff"])
    table = pa.table({"v": [[1.0, 2], [3]], "none": pa.array([None, 1.0])})
    pq.write_table(table, "odd.parquet")
    refused("odd.parquet: v has vectors of different lengths", "odd.parquet", "v", "none")
    pq.write_table(table[:0], "rowless.parquet")
    refused("rowless.parquet: it has no rows", "rowless.parquet", "none", "none")
    refused(r"leave the column of episodes out", "r.h5", episode="x")
    with h5py.File("r.h5", "a") as file:
        del file["data/demo_10/obs/grip"]
    refused(r"r\.h5, data/demo_10: no column is named grip", "r.h5")
    lerobot(tmp_path / "gap", skip=4)
    refused(r"episode 1: frame_index goes from 0 to 2", "gap")
    lerobot(tmp_path / "short", lengths=(3, 1))
    refused(r"parquet, episode 1: 1 observation and 1 action leave no row", "short")


@pytest.mark.parametrize(("library", "suffix"), [("pyarrow", "parquet"), ("h5py", "hdf5")])
def test_a_library_that_is_missing_is_named(tmp_path, monkeypatch, library, suffix):
    monkeypatch.setitem(sys.modules, library, None)
    path = tmp_path / f"a.{suffix}"
    path.write_text("")
    message = rf"\.{suffix} files need {library}: pip install 'jaxreplay\[{suffix}\]'"
    with pytest.raises(ConfigError, match=message):
        jr.read(path)


def test_the_command_line_takes_every_format(tmp_path, capsys):
    for name in ("demo2.csv", "demo10.csv"):
        (tmp_path / name).write_text(CSV)
    out = ["--out", str(tmp_path / "shown.png")]
    chosen = ["--sensors", "phi,x", "--commands", "u", "--angles", "phi", "--time", "t"]
    assert cli.main(["inspect", str(tmp_path), *chosen, *out]) == 0
    printed = capsys.readouterr().out
    assert "cos(phi)" in printed
    assert "2 " in printed.splitlines()[0]
    lerobot(tmp_path / "robot")
    assert cli.main(["inspect", str(tmp_path / "robot")]) == 0
    assert (tmp_path / "robot.png").exists()
    every = str(tmp_path / "*.csv")
    for command in ("inspect", "tune"):
        assert cli.main([command, every, "--sensors", "phy", "--commands", "u"]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "demo2.csv: no sensor is named phy; did you mean phi" in error
