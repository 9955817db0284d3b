import re

import pytest
from study_helpers import SMALL, of_beginnings, write

from jaxreplay import Records, cli, open_study
from jaxreplay.figures.table import table
from jaxreplay.study import cost
from jaxreplay.study.config import load_config
from jaxreplay.study.open import config_of

pytestmark = pytest.mark.usefixtures("fewer_windows")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The folder of a run that the command line did, among files of somebody else's."""
    folder = tmp_path_factory.mktemp("out")
    (folder / "notes.txt").write_text("mine")
    config = write(tmp_path_factory.mktemp("config"), SMALL)
    one = ["--set", "positions=[[0.28, 0]]"]
    assert cli.main(["run", str(config), "--out", str(folder), *one]) == 0
    return config, folder


def test_a_study_leaves_dataset_figure_and_demonstrations(study):
    config, folder = study
    names = {path.name for path in folder.iterdir()}
    (demonstrations,) = folder.glob("demonstrations_*.npz")
    assert names == {
        "study.json", "study.lock", "shards", "outcomes.png", "outcomes.pdf", demonstrations.name,
        "notes.txt",
    }  # fmt: skip
    assert (folder / "notes.txt").read_text() == "mine"
    assert Records.load(demonstrations).n_records == 20
    dataset = open_study(folder)
    assert dataset.sizes["demonstration"] == 20
    assert dataset.outcome.item() == "S"
    assert 0 < dataset.alignment_error.item() < 20  # mm: no magnet holds a face further aside
    assert config_of(dataset) == load_config(config, ["positions=[[0.28, 0]]"])


def test_a_finished_study_is_not_run_again_but_printed_and_drawn(study, capsys):
    config, folder = study
    (folder / "outcomes.png").unlink()
    (shard,) = (folder / "shards").iterdir()
    before = shard.stat().st_mtime_ns
    again = ["run", str(config), "--out", str(folder), "--set", "positions=[[0.28, 0]]"]
    assert cli.main(again) == 0
    printed = capsys.readouterr()
    assert f"{folder}: 1 run in 1 shard\n" in printed.err
    drawn = f"{folder}: the study, outcomes.png and outcomes.pdf\n"
    assert printed.out == f"{table(open_study(folder))}\n{drawn}"
    assert (folder / "outcomes.png").stat().st_size > 0
    assert shard.stat().st_mtime_ns == before


def test_a_dry_run_measures_what_a_study_takes_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(cost, "SAMPLE", 2)
    config = of_beginnings(tmp_path, SMALL + "motor_unit = [0.005, 0.01]\n")
    out = tmp_path / "out"
    given = ["run", str(config), "--out", str(out), "--dry-run", "--set", "slots=3"]
    assert cli.main(given) == 0
    printed = capsys.readouterr().err
    assert "10 runs in 1 shard\n" in printed
    time, unit, cores, seconds, memory = re.search(
        r"about ([\d.]+) (s|min) on (\d+) cores? \(([\d.]+) s a run on one\), ([\d.]+) GiB", printed
    ).groups()
    assert 0.01 < float(seconds) < 60
    expected = 10 * float(seconds) / int(cores)
    assert float(time) * {"s": 1, "min": 60}[unit] == pytest.approx(max(expected, 1), abs=4)
    assert 0.1 < float(memory) < 5
    assert not out.exists()


def test_the_command_line_describes_itself(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["run", "--help"])
    assert stop.value.code == 0
    assert "experiments/theta_i.toml" in capsys.readouterr().out
    with pytest.raises(SystemExit) as stop:
        cli.main(["walk"])
    assert stop.value.code == 2
