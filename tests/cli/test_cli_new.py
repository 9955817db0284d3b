"""The packaged experiments, and the command line's own options."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from jaxreplay import cli
from jaxreplay.study.config import load_config

ROOT = Path(__file__).parents[2]


def test_every_package_is_listed():
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {p.parent for p in (ROOT / "jaxreplay").rglob("__init__.py")}
    names = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    assert setuptools["packages"] == sorted(names | {"jaxreplay.experiments"})
    assert {f.parent for f in (ROOT / "jaxreplay").rglob("*.py")} == folders


def test_new_lists_each_experiment_with_its_question(capsys):
    assert cli.main(["new"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = sorted(path.stem for path in (ROOT / "experiments").glob("*.toml"))
    assert [line for line in lines if line in names] == names
    assert lines[lines.index("battery") + 1].startswith("    Is a full battery best")


def test_new_writes_an_experiment_that_can_be_read(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "theta_i"]) == 0
    assert capsys.readouterr().out == "jaxreplay run theta_i.toml\n"
    source = ROOT / "experiments" / "theta_i.toml"
    assert Path("theta_i.toml").read_bytes() == source.read_bytes()
    assert load_config("theta_i.toml") == load_config(source)
    assert cli.main(["new", "grid.toml", "--out", "mine.toml"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.toml", "theta_i.toml"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["new", "teta_i"], "there is no experiment teta_i; did you mean theta_i? (known: bat"),
        (["new", "grid", "--out", "here.toml"], "here.toml exists; give another name"),
        (["new", "--out", "there.toml"], "--out: give the NAME of an experiment, too"),
        (["list"], "results: there is no such folder"),
        (["list", "."], ".: contains no study"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    Path("here.toml").write_text("")
    assert cli.main(arguments) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    assert message in printed.err
    assert [path.name for path in tmp_path.iterdir()] == ["here.toml"]


def test_without_a_command_help_is_printed(capsys):
    assert cli.main([]) == 0
    assert capsys.readouterr().out.startswith("usage: jaxreplay")


def test_the_version_is_that_of_the_project(capsys):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    with pytest.raises(SystemExit) as stop:
        cli.main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"jaxreplay {project['version']}\n"


def test_help_loads_nothing_slow():
    """At most half a second of CPU; 0.3 s measured, of which importing gymnasium takes half."""
    program = (
        "import sys; from jaxreplay import cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "slow = {'jax', 'xarray', 'scipy', 'matplotlib', 'pymunk', 'tqdm'} & sys.modules.keys()\n"
        "assert not slow, slow"
    )
    before = os.times()
    subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    seconds = sum(after[2:4]) - sum(before[2:4])
    assert seconds < 1  # on a busy machine; a module that loads JAX alone takes 0.8 s
