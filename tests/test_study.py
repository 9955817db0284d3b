import numpy as np
import pytest
import xarray as xr

import jaxreplay as jr
from jaxreplay import cli
from jaxreplay.config import ConfigError, load_config
from jaxreplay.plane.demonstrator import TESTED
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES
from jaxreplay.records import Records
from jaxreplay.study import table

SMALL = """
seed = 4
repeats = 1
[axis]
theta_i = [0.01]
jump = ["own_tau"]
"""


def write(folder, text, name="study.toml"):
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A small study run from the command line, among files of somebody else's."""
    folder = tmp_path_factory.mktemp("out")
    (folder / "notes.txt").write_text("mine")
    config = write(tmp_path_factory.mktemp("config"), SMALL)
    assert cli.main(["run", str(config), "--out", str(folder)]) == 0
    return config, folder


def test_a_study_leaves_dataset_figure_and_demonstrations(study):
    _, folder = study
    names = {path.name for path in folder.iterdir()}
    (demonstrations,) = folder.glob("demonstrations_*.npz")
    assert names == {
        "study.nc", "figure_3.png", "figure_3.pdf", demonstrations.name, "notes.txt",
    }  # fmt: skip
    assert (folder / "notes.txt").read_text() == "mine"
    assert Records.load(demonstrations).n_records == 20


def test_the_dataset_is_labelled(study):
    dataset = jr.open_study(study[1])
    assert dict(dataset.sizes) == {"theta_i": 1, "jump": 1, "position": 5, "repeat": 1}
    assert dataset.outcome.dims == ("theta_i", "jump", "position", "repeat")
    assert dataset.alignment_error.attrs["units"] == "mm"
    assert dataset.duration.attrs["units"] == "s"
    np.testing.assert_array_equal(dataset.cube_x, TESTED[:, 0])
    assert set(np.unique(dataset.outcome)) <= {"S", "Fs", "Fg", "Fb"}
    won = dataset.sel(theta_i=0.01, jump="own_tau").outcome == "S"
    assert won.any()
    assert np.isfinite(dataset.alignment_error.values[0, 0][won.values]).all()
    assert np.isfinite(dataset.log_evidence).all()


def test_the_table_counts_the_dataset(study):
    dataset = jr.open_study(study[1])
    counts = [int((dataset.outcome == o).sum()) for o in ("S", "Fs", "Fg", "Fb")]
    row = next(line for line in table(dataset).splitlines() if line.strip().startswith("1.00e-02"))
    assert [int(n) for n in row.split()[1:5]] == counts
    errors = dataset.alignment_error.values[dataset.outcome.values == "S"]
    assert f"{errors.mean():.2f}" in row


def test_the_same_seed_gives_the_same_study(study, tmp_path):
    config, folder = study
    assert cli.main(["run", str(config), "--out", str(tmp_path)]) == 0
    xr.testing.assert_identical(jr.open_study(folder), jr.open_study(tmp_path))


def test_opening_what_is_no_study(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"study\.nc is missing"):
        jr.open_study(tmp_path)
    (tmp_path / "study.nc").write_bytes(b"CDF\x01 not much")
    with pytest.raises(ValueError, match="does not hold a study"):
        jr.open_study(tmp_path)


def test_the_shipped_experiment_is_the_papers(request):
    config = load_config(request.config.rootpath / "experiments" / "theta_i.toml")
    np.testing.assert_allclose(np.log10(config.theta_i), [-0.5, -1, -1.5, -2, -2.5, -3, -3.5])
    assert config.jump == ("same_tau", "own_tau")
    assert (config.theta_tau, config.sigma, config.repeats) == (0.05, 0.1, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_ta = 0.1\n[axis]\ntheta_i = [0.1]", "unknown key theta_ta; did you mean theta_tau"),
        ("[axis]\ntheta_i = [0.1]\nsigma = [1]", r"unknown key axis\.sigma"),
        ("[axis]\ntheta_i = [0.1, 1.5]", r"axis\.theta_i\[1\] must be in \[0, 1\]; got 1\.5"),
        ("[axis]\ntheta_i = [nan]", r"axis\.theta_i\[0\] must be in"),
        ("[axis]\ntheta_i = 0.1", r"axis\.theta_i must be a list"),
        ("[axis]\ntheta_i = []", r"axis\.theta_i must be a list of at least one"),
        ("[axis]\ntheta_i = [0.1, 0.1]", r"axis\.theta_i holds a value twice"),
        ("[axis]\ntheta_i = ['a']", r"axis\.theta_i\[0\] must be a number; got 'a'"),
        ("[axis]\ntheta_i = {logspac = [0, 1, 2]}", r"unknown key axis\.theta_i\.logspac; did you"),
        ("[axis]\ntheta_i = {logspace = [0, 1]}", r"logspace must be \[first exponent"),
        ("[axis]\ntheta_i = {logspace = [0, 1, 2]}", r"axis\.theta_i\[1\] must be in \[0, 1\]"),
        ("[axis]\ntheta_i = {logspace = [0, -1, 2.5]}", r"logspace\[2\] must be a whole number"),
        ("[axis]\njump = ['same_tau']", r"axis\.theta_i is missing"),
        ("[axis]\ntheta_i = [0.1]\njump = ['both']", r"axis\.jump\[0\] must be one of"),
        ("axis = 3", "axis must be a table"),
        ("theta_tau = 0.6\n[axis]\ntheta_i = [0.1]", r"theta_tau must be in \[0, 0\.5\]; got 0\.6"),
        ("sigma = 0\n[axis]\ntheta_i = [0.1]", r"sigma must be in \[1e-06, 1e\+06\]; got 0"),
        ("sigma = inf\n[axis]\ntheta_i = [0.1]", "sigma must be in"),
        ("repeats = 0\n[axis]\ntheta_i = [0.1]", "repeats must be a whole number from 1 to"),
        ("repeats = 10000000000\n[axis]\ntheta_i = [0.1]", "repeats must be a whole number"),
        ("theta_i = [0.1]", r"unknown key theta_i; it belongs under \[axis\]"),
        ("[axis]\ntheta_i = [0.1]\njump = [['own_tau']]", r"axis\.jump\[0\] must be one of"),
        ("[axis]\ntheta_i = [0.1]\njump = 'own_tau'", r"got 'own_tau'; write \['own_tau'\]"),
        (f"theta_tau = {'9' * 400}\n[axis]\ntheta_i = [0.1]", r"theta_tau must be in"),
        ("seed = true\n[axis]\ntheta_i = [0.1]", "seed must be a whole number"),
        ("demonstrations = 3\n[axis]\ntheta_i = [0.1]", "demonstrations must be a file's path"),
        ("demonstrations = 'no.npz'\n[axis]\ntheta_i = [0.1]", "there is no file"),
        ("[axis\n", "is not TOML"),
    ],
)
def test_a_mistake_is_one_line_and_status_2_before_any_work(tmp_path, capsys, text, message):
    config = write(tmp_path, text)
    with pytest.raises(ConfigError, match=message):
        load_config(config)
    out = tmp_path / "out"
    assert cli.main(["run", str(config), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1  # before the run is announced
    assert str(config) in said
    assert not out.exists()


def test_mistakes_outside_the_file_too(tmp_path, capsys):
    assert cli.main(["run", str(tmp_path / "none.toml")]) == 2
    assert "cannot be read: No such file" in capsys.readouterr().err

    other = Records.from_sequences([np.zeros((3, 2))], [np.zeros((3, 5))])
    other.save(tmp_path / "other.npz")
    config = write(tmp_path, 'demonstrations = "other.npz"\n' + SMALL)
    assert cli.main(["run", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "its sensors are z0, z1; the plane has camera" in capsys.readouterr().err

    (tmp_path / "other.npz").write_bytes(b"PK\x03\x04")
    assert cli.main(["run", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "does not hold records (truncated" in capsys.readouterr().err

    slow = [np.zeros((3, 7))], [np.zeros((3, 5))], SENSOR_NAMES, COMMAND_NAMES, 0.5
    Records.from_sequences(*slow).save(tmp_path / "other.npz")
    assert cli.main(["run", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "0.5 s apart; the plane's control period is 0.1 s" in capsys.readouterr().err

    (tmp_path / "file").write_text("")
    config = write(tmp_path, SMALL)
    assert cli.main(["run", str(config), "--out", str(tmp_path / "file")]) == 2
    assert "is a file; give a folder" in capsys.readouterr().err


def test_the_command_line_describes_itself(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["run", "--help"])
    assert stop.value.code == 0
    assert "experiments/theta_i.toml" in capsys.readouterr().out
    with pytest.raises(SystemExit) as stop:
        cli.main(["walk"])
    assert stop.value.code == 2
