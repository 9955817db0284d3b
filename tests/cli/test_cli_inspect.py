import re

import pytest
from PIL import Image
from recordings_helpers import sequences

from jaxreplay import Records, cli
from jaxreplay.recordings.inspect import inspect
from jaxreplay.recordings.report import report


def test_the_command_prints_and_draws(tmp_path, capsys):
    path, out = tmp_path / "demos.npz", tmp_path / "new" / "shown.svg"
    sensors, commands = sequences()
    sensors[2][20, 0] = 30
    records = Records.from_sequences(sensors, commands, ["turn", "x", "seen"])
    records.save(path)
    assert cli.main(["inspect", str(path), "--quick"]) == 0
    printed = capsys.readouterr().out
    assert printed == f"{report(inspect(records))}\n{tmp_path / 'demos.png'}\n"
    assert re.search(r"^turn +-?\d.* 2, 2[01] ", printed, re.MULTILINE)
    with Image.open(tmp_path / "demos.png") as image:
        assert image.format == "PNG"
    assert cli.main(["inspect", str(path), "--out", str(out), "--quick"]) == 0
    assert "<svg" in out.read_text(encoding="utf-8")


@pytest.mark.usefixtures("fewer_windows")
def test_it_scores_records_unless_it_shall_be_quick(tmp_path, capsys):
    path = tmp_path / "demos.npz"
    Records.from_sequences(*sequences((60, 62, 61))).save(path)
    assert cli.main(["inspect", str(path)]) == 0
    scored = capsys.readouterr().out
    rows = re.findall(r"^(\d|all) +(\d+) +[\d.]+% +-?[\d.]+$", scored, re.MULTILINE)
    assert rows == [("0", "60"), ("1", "62"), ("2", "61"), ("all", "183")]
    assert "command error with commands one row earlier: " in scored
    assert cli.main(["inspect", str(path), "--quick"]) == 0
    assert "command error" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no.npz"], r"no records file no\.npz"),
        (["text.npz"], r"text\.npz does not contain records \(truncated"),
        (["cut.npz"], r"cut\.npz does not contain records \(truncated"),
        (
            ["demos.npz", "--out", "shown.gif"],
            r"--out shown\.gif: its name must end in one of \.png",
        ),
        (["demos.png"], r"demos\.png: the figure would take its place; give --out"),
        (["demos.npz", "--out", "text.npz/shown.png"], "text.npz"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    records = Records.from_sequences(*sequences())
    for name in ("demos.npz", "demos.png"):
        records.save(name)
    whole = (tmp_path / "demos.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.npz").write_text("x,y\n1,2\n")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert cli.main(["inspect", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert re.search(message, printed.err)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
