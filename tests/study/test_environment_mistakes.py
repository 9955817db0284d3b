"""What can be wrong in a study in an environment, and what is told of its results."""

import warnings

import numpy as np
import pytest
from study_helpers import write

import jaxreplay as jr
from jaxreplay import cli
from jaxreplay.errors import ConfigError
from jaxreplay.figures.table import table
from jaxreplay.study.config import load_config
from jaxreplay.study.demonstrations import demonstrations


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("environment=Nowhere-v0", "environment Nowhere-v0 cannot be made: NameNotFound"),
        ("environment=no_such:X-v0", "environment no_such:X-v0 cannot be made: ModuleNotFound"),
        ("environment=Pendulum-v1", "observations are Box.*the records have 2 numbers a row"),
        ("environment=CartPole-v1", "observations are Box.*the records have 2 numbers a row"),
        ("environment=line_world:Endless-v0", "no time limit: give it one among its arguments"),
        ("environment.id=3", "environment must be an id of Gymnasium"),
        ("environment.colour=3", "environment must be an id of Gymnasium"),
        ("sigma_y=0.1", "sigma_y: by the sensors in .*line.npz there are sigma_x, sigma_seven"),
        ("motor_unit=0.01", "motor_unit is of the simulated robot; this study has an environment"),
        ("axis.light=[true]", "light is of the simulated robot"),
        ("theta_j=0.1", "unknown key theta_j; did you mean theta_i"),
        ("positions=[[0.3, 0.0]]", "a study in an environment has none"),
        ("plane.side=0.05", "a study in an environment has none"),
        ("demonstrations=gone.npz", "demonstrations: there is no file gone.npz"),
        ("demonstrations.files=x.csv", "unknown key demonstrations.files; did you mean"),
        ("demonstrations.sensors=[1]", "demonstrations.file must be a file's path"),
        ("success_return=much", "success_return must be a number; got 'much'"),
        ("repeats=0", "repeats must be a whole number from 1"),
        ("records=[0, 7]", "records: there is no 7; they are 0 to 1"),
    ],
)
def test_a_mistake_is_one_line_before_any_work(line, capsys, change, message):
    out = line.parent / "out"
    assert cli.main(["run", str(line), "--out", str(out), "--set", change]) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith("jaxreplay: ")
    assert not out.exists()
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(last)


def test_what_only_an_environment_has_needs_one(tmp_path):
    with pytest.raises(ConfigError, match="success_return is of an environment"):
        load_config(write(tmp_path, "theta_i = 0.1\nsuccess_return = 3"))
    with pytest.raises(ConfigError, match="demonstrations is missing"):
        load_config(write(tmp_path, 'theta_i = 0.1\nenvironment = "Line-v0"'))
    with pytest.raises(ConfigError, match="unknown key sigma_x"):
        load_config(write(tmp_path, "theta_i = 0.1\nsigma_x = 0.1"))
    assert load_config(write(tmp_path, "theta_i = 0.1")).repeats == 3


def test_a_study_whose_file_is_gone_can_be_seen_but_not_continued(line, capsys):
    folder = line.parent
    assert cli.main(["run", str(line), "--out", str(folder / "out")]) == 0
    before = table(jr.open_study(folder / "out"))
    (folder / "line.npz").rename(folder / "other.npz")
    assert table(jr.open_study(folder / "out")) == before
    capsys.readouterr()
    assert cli.main(["watch", str(folder / "out")]) == 2
    assert "there is no such file of demonstrations; put it back" in capsys.readouterr().err


def test_records_that_end_in_motion_are_told(line):
    steps = np.full((30, 1), 0.1)
    x = np.cumsum(steps, axis=0)
    moving = [np.hstack([x, np.sin(x)])] * 2
    jr.Records.from_sequences(moving, [steps] * 2).save(line.parent / "line.npz")
    with pytest.warns(UserWarning, match=r"still in motion at the end.*\(0: the environment alone"):
        demonstrations(load_config(line), line.parent)
    demonstrations(load_config(line, ["last_steps=0"]), line.parent)


def test_what_does_not_fit_the_environments_spaces_is_told(line):
    """As another order of sensors, or another unit of commands, does."""
    steps = np.full((12, 1), 0.1)
    seen = np.hstack([np.linspace(0, 1, 12)[:, None], np.full((12, 1), -0.5)])
    jr.Records.from_sequences([seen] * 2, [50 * steps, -steps], ["v", "x"], ["push"]).save(
        line.parent / "line.npz"
    )
    car = load_config(line, ["environment=MountainCarContinuous-v0", "last_steps=0"])
    with pytest.warns(UserWarning, match="of the environment.s") as told:
        demonstrations(car, line.parent)
    messages = sorted(str(w.message).partition("line.npz: ")[2] for w in told)
    for message, start in zip(
        messages,
        (
            "command push goes from -0.1 to 5, but number 0 of the environment's actions",
            "sensor v goes from 0 to 1, but number 0 of the environment's observ",
            "sensor x goes from -0.5 to -0.5, but number 1 of",
        ),
        strict=True,
    ):
        assert message.startswith(start)


def test_lost_runs_are_told_below_the_table(line):
    study = jr.run_study(load_config(line), line.parent / "out", lambda *so_far: None)
    assert "Lost" not in table(study)
    study.distance.values.flat[0] = 3.5
    assert "Lost: 1 of 2 runs were more than 3 σ off the sample followed" in table(study)


def test_an_error_of_the_environment_is_one_line(line, capsys):
    fails = line.read_text().replace(
        '"line_world:Line-v0"', '{id = "line_world:Line-v0", fails_at = 3}'
    )
    path = write(line.parent, fails, "fails.toml")
    assert cli.main(["run", str(path), "--out", str(line.parent / "out")]) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert "environment line_world:Line-v0 failed: ZeroDivisionError: " in last
    assert "line_world.py, line " in last
    assert cli.main(["watch", str(path)]) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert "environment line_world:Line-v0 failed: ZeroDivisionError: " in last


def test_watching_needs_the_demonstrations_of_the_study(line, capsys):
    assert cli.main(["run", str(line), "--out", str(line.parent / "out")]) == 0
    steps = np.full((32, 1), 0.05)
    x = np.cumsum(steps, axis=0)
    jr.Records.from_sequences(
        [np.hstack([x, 0 * x])] * 2, [steps] * 2, ["x", "seven"], ["dx"]
    ).save(line.parent / "line.npz")
    capsys.readouterr()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert cli.main(["watch", str(line.parent / "out")]) == 2
    assert "are not those with which it was run: put the file back" in capsys.readouterr().err


@pytest.mark.parametrize("key", ["success_return", "repeats", "theta_i"])
def test_a_key_of_the_study_below_a_table_is_told(line, key):
    text = line.read_text().replace('environment = "line_world:Line-v0"\n', "")
    text += f'[environment]\nid = "line_world:Line-v0"\n{key} = 3\n'
    with pytest.raises(ConfigError, match=rf"{key} is of the study: put it above \[environment\]"):
        load_config(write(line.parent, text))
