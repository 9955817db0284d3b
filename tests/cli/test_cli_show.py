"""The commands that read a finished study: show and plot."""

import csv
import io

import pytest
from study_helpers import made_up_study, write

from jaxreplay import cli, open_study
from jaxreplay.figures.table import table

TEXT = "theta_i = 0.01\n[axis]\njump = ['own_tau', 'same_tau']"


@pytest.fixture
def folder(tmp_path):
    made_up_study(write(tmp_path, TEXT), tmp_path / "out")
    return tmp_path / "out"


def test_show_prints_the_table(folder, capsys):
    assert cli.main(["show", str(folder)]) == 0
    printed = capsys.readouterr()
    assert printed.out == table(open_study(folder)) + "\n"
    assert printed.err == ""


def test_plot_draws_into_the_folder_and_changes_nothing_else(folder, capsys):
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert cli.main(["plot", str(folder)]) == 0
    assert capsys.readouterr().out == f"{folder}: outcomes.png and outcomes.pdf\n"
    after = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert {path.name for path in set(after) - set(before)} == {"outcomes.png", "outcomes.pdf"}
    assert before.items() <= after.items()


@pytest.mark.parametrize("command", ["show", "plot"])
def test_missing_runs_are_reported(folder, capsys, command):
    (folder / "shards" / "00001.nc").unlink()
    assert cli.main([command, str(folder)]) == 0
    assert capsys.readouterr().err == f"{folder}: 15 of 30 runs are missing\n"


@pytest.mark.parametrize("command", ["show", "plot"])
@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "study.json is missing; jaxreplay run makes it"), ("{", "is not the manifest of a st")],
)
def test_a_mistake_is_one_line_and_status_2(tmp_path, capsys, command, content, message):
    if content:
        (tmp_path / "study.json").write_text(content)
    before = list(tmp_path.iterdir())
    assert cli.main([command, str(tmp_path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert message in printed.err
    assert list(tmp_path.iterdir()) == before


def test_csv_has_a_row_for_each_run(folder, capsys):
    (folder / "shards" / "00001.nc").unlink()
    assert cli.main(["show", str(folder), "--csv"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    dataset = open_study(folder)
    assert list(rows[0]) == [
        "jump", "position", "cube_x", "cube_y", "repeat", *map(str, dataset.data_vars)
    ]  # fmt: skip
    assert len(rows) == dataset.outcome.size
    for row in rows:
        at = {"jump": row["jump"], "position": int(row["position"]), "repeat": int(row["repeat"])}
        run = dataset.sel(at)
        assert row["outcome"] == run.outcome
        assert row["duration"] == ("" if row["outcome"] == "" else repr(float(run.duration)))
        assert float(row["cube_y"]) == run.cube_y
