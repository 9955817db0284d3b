"""What a user can get wrong in what `jaxreplay run` reads."""

import re
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from study_helpers import SMALL, TUNED, made_up_study, some_records, write

from jaxreplay import cli, machine
from jaxreplay.errors import ConfigError
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES
from jaxreplay.records import Records
from jaxreplay.study import config
from jaxreplay.study.config import load_config
from jaxreplay.study.worlds.plane import PLANE_FACTORS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_ta = 0.1\n[axis]\ntheta_i = [0.1]", "unknown key theta_ta; did you mean theta_tau"),
        (
            "[axis]\ntheta_i = [0.1]\nsigm = [1]",
            r"unknown key axis\.sigm; did you mean axis\.sigma",
        ),
        ("[axis]\ntheta_i = [0.1, 1.5]", r"axis\.theta_i\[1\] must be in \[0, 1\]; got 1\.5"),
        ("[axis]\ntheta_i = [nan]", r"axis\.theta_i\[0\] must be in"),
        ("[axis]\ntheta_i = 0.1", r"axis\.theta_i must be a list.*; write \[0\.1\]"),
        ("[axis]\ntheta_i = []", r"axis\.theta_i must be a list of at least one"),
        ("[axis]\ntheta_i = [0.1, 0.1]", r"axis\.theta_i contains a value twice"),
        ("[axis]\ntheta_i = ['a']", r"axis\.theta_i\[0\] must be a number; got 'a'"),
        ("[axis]\ntheta_i = {logspac = [0, 1, 2]}", r"unknown key axis\.theta_i\.logspac; did you"),
        ("[axis]\ntheta_i = {logspace = [0, 1]}", r"logspace must be \[first exponent"),
        (
            "[axis]\ntheta_i = {linspace = [0, 1]}",
            r"linspace must be \[first value, last value, how",
        ),
        ("[axis]\ntheta_i = {logspace = [0, 1, 2]}", r"axis\.theta_i\[1\] must be in \[0, 1\]"),
        ("[axis]\ntheta_i = {logspace = [0, -1, 2.5]}", r"logspace\[2\] must be a whole number"),
        (
            "[axis]\ntheta_i = {linspace = [0, 1, 2], logspace = [0, 1, 2]}",
            "needs a list, or one of",
        ),
        ("[axis]\ntheta_i = {}", "needs a list, or one of linspace and logspace"),
        (
            "[axis]\njump = ['same_tau']",
            r"theta_i is missing; give one value, or a list as axis\.the",
        ),
        ("theta_i = 0.1\n[axis]\ntheta_i = [0.1]", r"theta_i and axis\.theta_i are both given"),
        ("theta_i = [0.1]", r"theta_i must be a number; got \[0\.1\]"),
        ("[axis]\ntheta_i = [0.1]\njump = ['both']", r"axis\.jump\[0\] must be one of"),
        ("axis = 3", "axis must be a table"),
        ("theta_i = 0.1\ntheta_tau = 0.6", r"theta_tau must be in \[0, 0\.5\]; got 0\.6"),
        ("theta_i = 0.1\nsigma = 0", r"sigma must be in \[1e-06, 1e\+06\]; got 0"),
        ("theta_i = 0.1\nsigma = inf", "sigma must be in"),
        ("theta_i = 0.1\ndithering = 1", "dithering must be one of false, true; got 1"),
        ("theta_i = 0.1\naxis.dithering = [true, 0]", r"axis\.dithering\[1\] must be one of false"),
        ("theta_i = 0.1\nmotor_unit = 0", r"motor_unit must be in \[1e-06, 0\.3\]; got 0"),
        ("theta_i = 0.1\nbattery = 2", r"battery must be in \[0\.05, 1\.5\]; got 2"),
        ("theta_i = 0.1\nsensor_noise = -1", r"sensor_noise must be in \[0, 100\]; got -1"),
        ("theta_i = 0.1\nsensor_noise = true", "sensor_noise must be a number; got True"),
        ("theta_i = 0.1\nrepeats = 0", "repeats must be a whole number from 1 to"),
        ("theta_i = 0.1\nrepeats = 10000000000", "repeats must be a whole number"),
        ("[axis]\ntheta_i = [0.1]\njump = [['own_tau']]", r"axis\.jump\[0\] must be one of"),
        ("[axis]\ntheta_i = [0.1]\njump = 'own_tau'", r"got 'own_tau'; write \['own_tau'\]"),
        ("theta_i = 0.1\njump = ['own_tau']", "jump must be one of 'same_tau', 'own_tau'"),
        (f"theta_i = 0.1\ntheta_tau = {'9' * 400}", r"theta_tau must be in"),
        ("theta_i = 0.1\nseed = true", "seed must be a whole number"),
        ("theta_i = 0.1\ndemonstrations = 3", "demonstrations must be a file's path"),
        ("theta_i = 0.1\ndemonstrations = 'no.npz'", "there is no file"),
        ("theta_i = 0.1\nsigma_camra = 1", "unknown key sigma_camra; did you mean sigma_camera"),
        ("theta_i = 0.1\nrecords = 0", "records must be a whole number from 1 to"),
        ("theta_i = 0.1\nrecords = 'six'", "records must be how many records to draw, such as 6"),
        ("theta_i = 0.1\nrecords = [1, -1]", r"records\[1\] must be a whole number from 0 to"),
        ("theta_i = 0.1\nrecords = [1, 1]", "records contains a record twice"),
        ("theta_i = 0.1\nslots = 0", "slots must be a whole number from 1 to 4096"),
        ("theta_i = 0.1\npositions = []", r"positions must be a list of \[x, y\] in m"),
        ("theta_i = 0.1\npositions = [[0.3]]", r"positions\[0\] must be \[x, y\] in m"),
        ("theta_i = 0.1\npositions = [[0.1, 0]]", r"positions\[0\]\[0\] must be in \[0\.2, 0\.7\]"),
        ("theta_i = 0.1\npositions = {x = [0.3]}", "positions needs x and y"),
        ("theta_i = 0.1\npositions = {x = [0.3], z = [0]}", r"unknown key positions\.z"),
        ("zip = 3\ntheta_i = 0.1", "zip must list groups of axes"),
        ("zip = [['sigma', 'battery']]\ntheta_i = 0.1", "zip names 'sigma', which is no axis"),
        (
            "zip = [['theta_i', 'battery']]\n[axis]\ntheta_i = [0.1]\nbattery = [1, 0.5]",
            r"zip: theta_i, battery have \[1, 2\] values; give the same number of each",
        ),
        ("[axis\n", "is not TOML"),
        (f"theta_i = {'9' * 5000}", "is not TOML"),
        (f"theta_i = {'[' * 3000}", "is not TOML: too deeply nested"),
        ("zip = [[['a'], ['b']]]\ntheta_i = 0.1", r"zip names \['a'\], which is no axis"),
        ("theta_i = 1e-300", r"theta_i must be 0 or at least 1\.2e-38; got 1e-300"),
        (
            "repeats = 10000\n[axis]\ntheta_i = {linspace = [0, 1, 10000]}\n"
            "theta_tau = {linspace = [0, 0.5, 10000]}",
            r"the study has 5e\+12 runs; at most 1,000,000",
        ),
    ],
)
def test_a_mistake_is_one_line_and_status_2_before_any_work(tmp_path, capsys, text, message):
    config = write(tmp_path, text)
    with pytest.raises(ConfigError, match=message):
        load_config(config)
    out = tmp_path / "out"
    assert cli.main(["run", str(config), "--out", str(out)]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1  # before the run is announced
    assert str(config) in printed
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("theta_i", "--set theta_i: give KEY=VALUE"),
        ("=3", "--set =3: give KEY=VALUE"),
        ("theta_j=0.1", "unknown key theta_j; did you mean theta_i"),
        ("axis.theta_i=0.1", r"axis\.theta_i must be a list"),
        ("jump=[", "jump must be one of 'same_tau', 'own_tau'; got '\\['"),
    ],
)
def test_a_mistake_in_set_is_reported_too(tmp_path, capsys, change, message):
    config = write(tmp_path, SMALL)
    assert cli.main(["run", str(config), "--set", change, "--out", str(tmp_path / "out")]) == 2
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_i = ", "tuned.toml: is not TOML"),
        (SMALL, "must contain theta_i, theta_tau and a table sigma, as jaxreplay tune saves"),
        (TUNED.replace("proximeter_5", "sonar"), "4, sonar; the study's are camera"),
        (TUNED.replace("= 0.1\n", "= 'a'\n"), "tuned.toml: sigma.proximeter_0 must be a number"),
        (
            TUNED.replace("= 0.1\n", "= 0\n"),
            "toml: sigma.proximeter_0 must be in [1e-06, 1e+06]; got 0",
        ),
        (TUNED.replace("0.03", "3"), "tuned.toml: theta_i must be in [0, 1]; got 3"),
    ],
)
def test_a_mistake_in_tuned_parameters_is_reported(tmp_path, capsys, text, message):
    config, out = write(tmp_path, "theta_i = 0.1"), tmp_path / "out"
    tuned = write(tmp_path, text, "tuned.toml")
    assert cli.main(["run", str(config), "--params", str(tuned), "--out", str(out)]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert not out.exists()


def test_mistakes_outside_the_file_too(tmp_path, capsys):
    assert cli.main(["run", str(tmp_path / "none.toml")]) == 2
    message = "none.toml: there is no such file; jaxreplay new NAME writes one"
    assert message in capsys.readouterr().err
    assert cli.main(["run", "experiments/thetai.toml"]) == 2
    assert "jaxreplay new theta_i writes one" in capsys.readouterr().err

    other = Records.from_sequences([np.zeros((3, 2))], [np.zeros((3, 5))])
    other.save(tmp_path / "other.npz")
    config = write(tmp_path, 'demonstrations = "other.npz"\n' + SMALL)
    assert cli.main(["run", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "its sensors are z0, z1; the simulated robot has camera" in capsys.readouterr().err

    (tmp_path / "other.npz").write_bytes(b"PK\x03\x04")
    assert cli.main(["run", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "does not contain records (truncated" in capsys.readouterr().err

    slow = [np.zeros((3, 7))], [np.zeros((3, 5))], SENSOR_NAMES, COMMAND_NAMES, 0.5
    Records.from_sequences(*slow).save(tmp_path / "other.npz")
    assert cli.main(["run", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "0.5 s apart; the plane's control period is 0.1 s" in capsys.readouterr().err

    config = write(tmp_path, "records = [3, 20]\n" + SMALL)
    assert cli.main(["run", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "records: there is no 20; they are 0 to 19 (of" in capsys.readouterr().err

    (tmp_path / "file").write_text("")
    config = write(tmp_path, SMALL)
    assert cli.main(["run", str(config), "--out", str(tmp_path / "file")]) == 2
    assert "is a file; give a folder" in capsys.readouterr().err


def test_a_file_of_demonstrations_that_is_gone_is_missed_not_made_anew(tmp_path, capsys):
    mine, out = tmp_path / "mine.npz", tmp_path / "out"
    some_records().save(mine)
    made_up_study(write(tmp_path, 'demonstrations = "mine.npz"\n' + SMALL), out)
    mine.unlink()
    assert cli.main(["watch", str(out)]) == 2
    assert "mine.npz: there is no such file of demonstrations; put it" in capsys.readouterr().err
    assert not mine.exists()


def test_a_byte_order_mark_is_no_mistake(tmp_path):
    path = tmp_path / "study.toml"
    path.write_bytes(b"\xef\xbb\xbftheta_i = 0.1\n")
    assert load_config(path).fixed["theta_i"] == 0.1


def test_a_file_that_is_no_studys_is_not_read(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(machine, "LARGEST_TOML", 20)
    path = write(tmp_path, "theta_i = 0.1  # and much more")
    assert cli.main(["run", str(path)]) == 2
    assert "is larger than 0 MiB: not a study's file" in capsys.readouterr().err


@pytest.mark.parametrize("change", ["theta_i=0.1\ntheta_tau=0.2", "theta_i=" + 3000 * "["])
def test_a_change_is_one_line(tmp_path, capsys, change):
    path = write(tmp_path, "theta_i = 0.1")
    assert cli.main(["run", str(path), "--set", change]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--set" in line


KEYS = [*PLANE_FACTORS, "zip", "positions", "repeats", "seed", "slots", "demonstrations", "plane"]
KEYS += ["environment", "success_return", "axis", "sigma_x", "theta", ""]
INNER = ["linspace", "logspace", "x", "y", "file", "id", "sensors"]
PLAIN = st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
PLAIN |= st.sampled_from(["own_tau", "filter", "Pendulum-v1", 0.1, 3])
VALUES = st.recursive(
    PLAIN,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from([*KEYS, "linspace", "x", "y", "file", "id"]), inner, max_size=3
        )
    ),
    max_leaves=6,
)


@settings(max_examples=200, deadline=None)
@given(given=st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=5), with_theta=st.booleans())
def test_whatever_a_file_contains_is_a_study_or_a_mistake_in_one_line(given, with_theta):
    if with_theta:
        given = {"theta_i": 0.1} | given
    with mock.patch.object(config, "read_toml", return_value=given):
        message = mistake_of(lambda: load_config("any.toml"))
    assert message is None or (message.startswith("any.toml: ") and "\n" not in message)


def mistake_of(call):
    """The message of the ConfigError that a call raises, if it does."""
    try:
        call()
    except ConfigError as error:
        return str(error)
    return None


@pytest.mark.parametrize(
    ("records", "message"),
    [("21", "records: 21 cannot be drawn from 20"), ("[20]", "there is no 20; they are 0 to 19")],
)
def test_a_choice_of_records_is_checked_before_demonstrations_are_made(
    tmp_path, capsys, records, message
):
    path, out = write(tmp_path, f"theta_i = 0.1\nrecords = {records}"), tmp_path / "out"
    assert cli.main(["run", str(path), "--out", str(out)]) == 2
    assert message in capsys.readouterr().err
    assert not list(out.rglob("*.npz"))
