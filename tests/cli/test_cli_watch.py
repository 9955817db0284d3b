import re
from pathlib import Path

import pytest
from PIL import Image
from trace_helpers import trace

from jaxreplay import cli
from jaxreplay.cli.watch import parse_run
from jaxreplay.figures.animation import title
from jaxreplay.study import again


def test_the_run_is_done_again_and_saved(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text("theta_i = 0.1")
    asked = []

    def run_again(config, records, k):
        (each,) = records.values()
        asked.append((config.fixed["theta_i"], each.n_records, k))
        return trace()

    monkeypatch.setattr(again, "run_again", run_again)
    for arguments, path in (
        (["--run", "7", "--speed", "40"], "results/study/run_7.html"),
        (["--out", "run.gif", "--speed", "40"], "run.gif"),
        (["--out", "new/end.png"], "new/end.png"),
        (["--run", "theta_i=0.1,position=2,repeat=1"], "results/study/run_7.html"),
    ):
        assert cli.main(["watch", "study.toml", *arguments]) == 0
        assert capsys.readouterr().out == f"{title(trace())}\n{path}\n"
        if path.endswith("html"):
            assert "S, error 2.3 mm" in Path(path).read_text("utf-8")
            continue
        with Image.open(path) as image:
            assert image.format == path[-3:].upper()
    assert asked == [(0.1, 20, k) for k in (7, 0, 0, 7)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no.toml"], r"no\.toml: there is no such file; jaxreplay new"),
        (["{config}", "--run", "1000"], "the study has 15 runs; give 0 to 14"),
        (["{config}", "--run", "Fx"], "give a run's number, or one of S, Fs, Fg, Fb, fixed"),
        (["{config}", "--run", "S"], "the study has no outcomes yet; give a study's folder"),
        (["{config}", "--run", "theta_j=1"], "the study has no theta_j"),
        (["{config}", "--run", "theta_i=2"], r"theta_i=2: the study's values are 0\.1"),
        (["{config}", "--run", "theta_i=0.2"], r"the study's values are 0\.1"),
        (["{config}", "--run", "repeat=3"], "the study's values are 0, 1, 2"),
        (["{config}", "--run", "theta_i="], "give NAME=VALUE"),
        (["{config}", "--run", "foo"], "values such as theta_i=0.01,position=0"),
        (["{config}", "--run", "position=0 repeat=0"], "separate values by commas, such as"),
        (["{config}", "--run", "jump=own_tau;repeat=0"], "separate values by commas, such as"),
        (["{config}", "--out", "run.mp4"], r"its name must end in \.html for a page"),
        (["{folder}"], r"study\.json is missing"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text("theta_i = 0.1")
    given = [a.format(config="study.toml", folder=str(tmp_path)) for a in arguments]
    assert cli.main(["watch", *given]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert re.search(message, printed)
    assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]


def test_a_run_is_named_by_number_word_or_values():
    assert parse_run("7") == 7
    assert parse_run("Fs") == "Fs"
    assert parse_run("jump=own_tau, theta_i=1e-25,records=[0, 4],dithering=true,repeat=2") == {
        "jump": "own_tau", "theta_i": 1e-25, "records": [0, 4], "dithering": True, "repeat": 2,
    }  # fmt: skip
