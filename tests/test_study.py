import re

import numpy as np
import pytest
import xarray as xr

import jaxreplay as jr
from jaxreplay import cli, estimate, factors
from jaxreplay import config as config_module
from jaxreplay import runs as runs_module
from jaxreplay import study as study_module
from jaxreplay.config import ConfigError, StudyConfig, load_config, tuned_changes
from jaxreplay.factors import FACTORS
from jaxreplay.figures import figure_3
from jaxreplay.plane.demonstrator import TESTED, facing
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, SENSOR_RANGES
from jaxreplay.records import Records
from jaxreplay.runs import records_of, runs_of, setting, shards_of
from jaxreplay.store import manifest_of, read_manifest
from jaxreplay.study import config_of, run_study
from jaxreplay.table import table

pytestmark = pytest.mark.usefixtures("fewer_windows")

SMALL = """
seed = 4
repeats = 1
[axis]
theta_i = [0.01]
jump = ["own_tau"]
"""
DITHERED = """
seed = 4
repeats = 1
theta_i = 0.01
jump = "own_tau"
[axis]
dithering = [true, false]
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


@pytest.fixture(scope="module")
def dithered(tmp_path_factory):
    """A study of which the one above is a half, and what running it returned."""
    folder = tmp_path_factory.mktemp("dithered")
    return folder, run_study(load_config(write(folder, DITHERED)), folder)


def test_a_study_leaves_dataset_figure_and_demonstrations(study):
    _, folder = study
    names = {path.name for path in folder.iterdir()}
    (demonstrations,) = folder.glob("demonstrations_*.npz")
    assert names == {
        "study.json", "study.lock", "shards", "outcomes.png", "outcomes.pdf", demonstrations.name,
        "notes.txt",
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
    errors = dataset.alignment_error.values[0, 0]
    np.testing.assert_array_equal(np.isfinite(errors), won.values)
    assert np.nanmax(errors) < 20  # mm: no magnet holds a face further aside
    assert np.isfinite(dataset.log_evidence).all()


def test_a_stall_is_told_of_each_run_over_3_minutes_and_of_no_other(study, dithered):
    for dataset in (jr.open_study(study[1]), dithered[1]):
        stalled = dataset.outcome == "Fs"
        np.testing.assert_array_equal(dataset.stall.isin(["fixed", "cyclic", "slow"]), stalled)
        np.testing.assert_array_equal(dataset.stall == "", ~stalled)
        np.testing.assert_array_equal(dataset.duration == 180, stalled)


def test_running_a_study_returns_what_opening_it_does(dithered):
    folder, returned = dithered
    opened = jr.open_study(folder)
    xr.testing.assert_identical(returned, opened)
    assert opened.outcome.dims == ("dithering", "position", "repeat")
    assert list(opened.dithering.values) == [True, False]
    assert config_of(opened) == load_config(folder / "study.toml")


def test_a_run_comes_to_the_same_in_whichever_study_it_stands(study, dithered):
    alone = jr.open_study(study[1]).isel(theta_i=0, jump=0, drop=True)
    among = dithered[1].sel(dithering=False, drop=True)
    audits = ["total_variation", "command_error"]  # of the first run of each shard
    xr.testing.assert_equal(alone.drop_vars(audits), among.drop_vars(audits))
    assert not (dithered[1].sel(dithering=True).log_evidence == alone.log_evidence).any()


def test_a_study_of_one_value_each_has_a_row_and_a_figure(dithered, tmp_path):
    dataset = dithered[1].isel(dithering=0, drop=True)
    assert len([line for line in table(dataset).splitlines() if line]) == 4
    figure_3(dataset, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 0


def test_a_study_of_no_numbers_has_a_figure(dithered, tmp_path):
    figure_3(dithered[1], tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 0


def test_the_table_counts_the_dataset(study):
    dataset = jr.open_study(study[1])
    counts = [int((dataset.outcome == o).sum()) for o in ("S", "Fs", "Fg", "Fb")]
    row = table(dataset).splitlines()[1]
    assert row.split()[:2] == ["0.01", "own_tau"]
    assert [int(n) for n in row.split()[2:6]] == counts
    errors = dataset.alignment_error.values[dataset.outcome.values == "S"]
    assert f"{errors.mean():.2f}" in row


def test_a_row_of_the_table_is_a_cell_of_the_study():
    dims = ("motor_unit", "dithering", "position", "repeat")
    cells = {
        "outcome": [["S", "S", "Fs"], ["Fs", "Fs", "Fb"]],
        "stall": [["", "", "cyclic"], ["fixed", "slow", ""]],
        "alignment_error": [[1, 3, np.nan], 3 * [np.nan]],
        "duration": [[60, 70, 180], [180, 180, 9]],
        "command_error": [[np.nan, 0.02, 1e-6], 3 * [np.nan]],
    }
    variables = {name: (dims, np.array(cell).reshape(1, 2, 1, 3)) for name, cell in cells.items()}
    coords = {"motor_unit": [0.0025], "dithering": [True, False]}
    header, *rows, audit = table(xr.Dataset(variables, coords)).splitlines()
    assert "of 2 filtered again" in audit
    assert "in 1; at most by 2.0e-02" in audit
    assert "motor unit" in header
    assert [" ".join(row.split()) for row in rows[:3]] == [
        "0.0025 on 2 1 0 0 67 (21–94) 0 1 0 2.00 ± 1.00 65.00 ± 5.00",
        "0.0025 off 0 2 0 1 0 (0–56) 1 0 1 – –",
        "",
    ]


def test_the_same_seed_gives_the_same_study(study, tmp_path):
    config, folder = study
    assert cli.main(["run", str(config), "--out", str(tmp_path)]) == 0
    xr.testing.assert_identical(jr.open_study(folder), jr.open_study(tmp_path))


def test_a_study_made_before_a_factor_was_known_stays_what_it_was(study, monkeypatch):
    config, folder = study
    before = jr.open_study(folder)
    held = manifest_of(load_config(config), records := Records.load(*folder.glob("*.npz")), 56)
    assert held["hash"] == read_manifest(folder)["hash"]
    new = FACTORS | {"mood": FACTORS["light"]}
    for module in (factors, study_module, runs_module, config_module):
        monkeypatch.setattr(module, "FACTORS", new)
    xr.testing.assert_identical(jr.open_study(folder), before)
    assert manifest_of(load_config(config), records, 56)["hash"] == held["hash"]
    older = read_manifest(folder)
    del older["config"]["zip"], older["config"]["positions"]  # nor were these
    assert study_module._config(older).positions == load_config(config).positions


def test_opening_what_is_no_study(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"study\.json is missing"):
        jr.open_study(tmp_path)
    (tmp_path / "study.json").write_text('{"config": ')
    with pytest.raises(ValueError, match="is not the manifest of a study"):
        jr.open_study(tmp_path)


def test_the_shipped_experiment_is_the_papers(request):
    config = load_config(request.config.rootpath / "experiments" / "theta_i.toml")
    assert list(config.axes) == ["jump", "theta_i"]
    exponents = [-0.5, -1, -1.5, -2, -2.5, -3, -3.5, -6, -12, -25]
    np.testing.assert_allclose(np.log10(config.axes["theta_i"]), exponents)
    assert config.axes["jump"] == ("same_tau", "own_tau")
    assert (config.fixed["theta_tau"], config.fixed["sigma"], config.repeats) == (0.05, 0.1, 3)
    assert not config.fixed["dithering"]


def test_every_shipped_experiment_can_be_read(request):
    paths = list((request.config.rootpath / "experiments").glob("*.toml"))
    assert paths
    for path in paths:
        assert len(runs_of(load_config(path))) > 0


def test_a_factor_is_one_value_or_an_axis_in_the_files_order(tmp_path):
    config = load_config(
        write(
            tmp_path,
            """
            sigma = 0.2
            battery = 1
            [axis]
            sensor_noise = {linspace = [0, 2, 5]}
            dithering = [true, false]
            theta_i.logspace = [-1, -3, 3]
            """,
        )
    )
    assert list(config.axes.items()) == [
        ("sensor_noise", (0.0, 0.5, 1.0, 1.5, 2.0)),
        ("dithering", (True, False)),
        ("theta_i", (0.1, 0.01, 0.001)),
    ]
    said = {name: value for name, value in config.fixed.items() if value is not None}
    assert said == {
        "theta_tau": 0.05, "sigma": 0.2, "jump": "same_tau", "motor_unit": 0.005, "battery": 1.0,
    }  # fmt: skip
    runs = runs_of(config)
    assert len(runs) == 5 * 2 * 3 * 5 * 3  # … × positions × repeats
    assert set(runs.values) == set(FACTORS)
    first = {name: values[0] for name, values in runs.values.items()}
    assert first == config.fixed | {"sensor_noise": 0.0, "dithering": True, "theta_i": 0.1}
    np.testing.assert_array_equal(runs.repeat[:4], [0, 1, 2, 0])
    np.testing.assert_array_equal(runs.position[:16:3], [0, 1, 2, 3, 4, 0])
    np.testing.assert_array_equal(runs.values["theta_i"][:46:15], [0.1, 0.01, 0.001, 0.1])


def test_what_a_run_is_told_follows_from_its_own_values():
    values = {name: factor.default for name, factor in FACTORS.items()} | {"theta_i": 0.1}

    def config(seed=7, **axes):
        fixed = {name: value for name, value in values.items() if name not in axes}
        return StudyConfig(axes, fixed, repeats=2, seed=seed)

    def told(config):
        params, seeds, options = setting(config, runs := runs_of(config))
        sigma = np.asarray(params.sigma) / SENSOR_RANGES
        np.testing.assert_allclose(sigma.T, np.tile(runs.values["sigma"], (7, 1)), rtol=1e-6)
        np.testing.assert_array_equal(options["cube"], facing(TESTED[runs.position]))
        for name in ("motor_unit", "dithering", "battery", "sensor_noise"):
            np.testing.assert_array_equal(options[name], runs.values[name])
        return np.array(seeds, np.uint64)

    one, two = config(theta_i=(0.1,)), config(theta_i=(0.2, 0.1))
    assert len(set(told(two))) == 20
    np.testing.assert_array_equal(told(one), told(two)[10:])
    np.testing.assert_array_equal(told(one), told(config()))
    crossed = told(config(dithering=(True, False), theta_i=(0.1, 0.2))).reshape(2, 2, 10)
    turned = told(config(theta_i=(0.2, 0.1), dithering=(False, True))).reshape(2, 2, 10)
    np.testing.assert_array_equal(crossed, turned.swapaxes(0, 1)[::-1, ::-1])
    np.testing.assert_array_equal(crossed[1, 0], told(one))
    assert not set(told(one)) & set(told(config(seed=8)))
    each = setting(two, runs_of(two).of(np.array([13, 2])))[1]
    np.testing.assert_array_equal(np.array(each, np.uint64), told(two)[[13, 2]])


VARIED = """
theta_i = 0.01
repeats = 2
sigma_proximeters = 0.2
positions = {x = [0.3, 0.35], y = {linspace = [-0.1, 0.1, 3]}}
zip = [["motor_unit", "sigma_camera"]]
[axis]
sigma_camera = [0.1, 0.3]
jump = ["own_tau", "same_tau"]
motor_unit = [0.005, 0.01]
records = [[0, 4, 19], 6]
sigma_proximeter_2 = [0.5]
"""


def test_axes_that_are_zipped_move_together(tmp_path):
    config = load_config(write(tmp_path, VARIED))
    assert config.dims == {
        "motor_unit": ("motor_unit", "sigma_camera"),
        "jump": ("jump",),
        "records": ("records",),
        "sigma_proximeter_2": ("sigma_proximeter_2",),
    }
    runs = runs_of(config)
    assert len(runs) == 2 * 2 * 2 * 6 * 2
    pairs = set(zip(runs.values["motor_unit"], runs.values["sigma_camera"], strict=True))
    assert pairs == {(0.005, 0.1), (0.01, 0.3)}
    still = ["axis.sigma_camera=[0.1, 0.1]"]
    assert load_config(write(tmp_path, VARIED), still).axes["sigma_camera"] == (0.1, 0.1)
    with pytest.raises(ConfigError, match=r"axis\.motor_unit, axis\.sigma_camera holds a value tw"):
        load_config(write(tmp_path, VARIED), [*still, "axis.motor_unit=[0.01, 0.01]"])


def test_cubes_stand_where_the_file_says(tmp_path):
    config = load_config(write(tmp_path, VARIED))
    assert config.positions == tuple((x, y) for x in (0.3, 0.35) for y in (-0.1, 0, 0.1))
    runs = runs_of(config)
    cubes = setting(config, runs)[2]["cube"]
    np.testing.assert_array_equal(cubes[:, :2], np.array(config.positions)[runs.position])
    listed = load_config(write(tmp_path, "theta_i = 0.1\npositions = [[0.3, 0], [0.4, 0.2]]"))
    assert listed.positions == ((0.3, 0.0), (0.4, 0.2))


def test_the_sigma_of_a_sensor_is_the_closest_one_said(tmp_path):
    config = load_config(write(tmp_path, VARIED))
    runs = runs_of(config)
    sigma = np.asarray(setting(config, runs)[0].sigma)
    wide = runs.values["sigma_camera"] == 0.3
    expected = np.tile([2 * 0.1, 0.2, 0.2, 0.5, 0.2, 0.2, 0.2], (len(runs), 1))
    expected[wide, 0] = 2 * 0.3
    np.testing.assert_allclose(sigma, expected, rtol=1e-6)


def test_runs_of_a_shard_share_the_jump_and_the_records(tmp_path):
    config = load_config(write(tmp_path, VARIED))
    runs, n = runs_of(config), 20
    shards = shards_of(runs, 8)
    np.testing.assert_array_equal(np.sort(np.concatenate(shards)), np.arange(len(runs)))
    sensors = [np.full((5, 7), float(i)) for i in range(n)]
    records = Records.from_sequences(sensors, [np.zeros((5, 5))] * n, SENSOR_NAMES, COMMAND_NAMES)
    drawn = {}
    for shard in shards:
        assert 0 < len(shard) <= 8
        some = runs.of(shard)
        assert len(set(some.values["jump"])) == 1
        (told,) = set(some.values["records"])
        chosen = records_of(config, records, some)
        first = [int(s[0, 0]) for s in chosen.sequences()[0]]
        if told == "0 4 19":
            assert first == [0, 4, 19]
        else:
            (repeat,) = set(some.repeat)
            assert len(set(first)) == 6
            assert drawn.setdefault(repeat, first) == first
    assert drawn[0] != drawn[1]


def test_what_set_says_takes_the_place_of_what_the_file_says(tmp_path):
    file = write(tmp_path, "theta_i = 0.1\n[axis]\nsigma = {linspace = [0.1, 0.2, 3]}")
    changes = """axis.theta_i.logspace=[-1, -2, 2]; sigma=0.3; jump=own_tau; slots = 7
        positions.x=[0.3]; positions.y.linspace=[0, 0.1, 2]""".replace("\n", ";").split(";")
    config = load_config(file, changes)
    assert config.axes == {"theta_i": (0.1, 0.01)}
    assert (config.fixed["sigma"], config.fixed["jump"]) == (0.3, "own_tau")
    assert config.positions == ((0.3, 0.0), (0.3, 0.1))
    assert config.slots == 7
    spaced = load_config(file, ["axis.sigma.logspace=[-1, 0, 2]"])
    assert spaced.axes == {"sigma": (0.1, 1.0)}


def test_a_dry_run_measures_what_a_study_takes_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(estimate, "SAMPLE", 2)
    config, out = write(tmp_path, SMALL + "motor_unit = [0.005, 0.01]\n"), tmp_path / "out"
    assert cli.main(["run", str(config), "--out", str(out), "--dry-run", "--slots", "3"]) == 0
    said = capsys.readouterr().err
    assert "10 runs in 1 shard\n" in said
    minutes, cores, seconds, memory = re.search(
        r"about ([\d.]+) min on (\d+) cores? \(([\d.]+) s a run on one\), ([\d.]+) GiB", said
    ).groups()
    assert 0.01 < float(seconds) < 60
    assert float(minutes) == pytest.approx(10 * float(seconds) / int(cores) / 60, abs=0.06)
    assert 0.1 < float(memory) < 5
    assert not out.exists()


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
        ("[axis]\ntheta_i = [0.1, 0.1]", r"axis\.theta_i holds a value twice"),
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
        ("theta_i = 0.1\nrecords = [1, 1]", "records holds a record twice"),
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
            r"zip: theta_i, battery have \[1, 2\] values; give as many of each",
        ),
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
def test_a_mistake_in_set_is_told_too(tmp_path, capsys, change, message):
    config = write(tmp_path, SMALL)
    assert cli.main(["run", str(config), "--set", change, "--out", str(tmp_path / "out")]) == 2
    assert re.search(message, capsys.readouterr().err)


TUNED = "theta_i = 0.03\ntheta_tau = 0.2\n[sigma]\n" + "".join(
    f'"{name}" = {0.05 * (k + 1)!r}\n' for k, name in enumerate(SENSOR_NAMES)
)


def test_tuned_parameters_are_those_of_the_study(tmp_path):
    file = write(tmp_path, SMALL + "sigma_proximeter_2 = [0.1, 0.2]\n")
    config = load_config(file, tuned_changes(write(tmp_path, TUNED, "tuned.toml")))
    assert list(config.axes) == ["jump"]
    params, *_ = setting(config, runs_of(config))
    np.testing.assert_allclose(params.theta_i, 0.03, rtol=1e-6)
    np.testing.assert_allclose(params.theta_tau, 0.2, rtol=1e-6)
    expected = np.tile(0.05 * np.arange(1, 8), (5, 1))  # in the sensors' units, as in the file
    np.testing.assert_allclose(params.sigma, expected, rtol=1e-6)


@pytest.mark.parametrize("light", ["", "light = true\n"])
def test_an_axis_of_sigma_without_effect_is_refused(tmp_path, light):
    file = write(tmp_path, light + SMALL + "sigma = [0.1, 0.2]\nsigma_proximeters = [0.1, 0.2]\n")
    load_config(file)
    tuned = tuned_changes(write(tmp_path, TUNED, "tuned.toml"))
    name = "sigma_proximeters" if light else "sigma"  # which is the light's, if there is one
    with pytest.raises(ConfigError, match=rf"axis\.{name} has no effect: each of its sensors"):
        load_config(file, tuned)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_i = ", "tuned.toml: is not TOML"),
        (SMALL, "must hold theta_i, theta_tau and a table sigma, as jaxreplay tune saves"),
        (TUNED.replace("proximeter_5", "sonar"), "proximeter_4, sonar; the plane has camera, prox"),
        (TUNED.replace("= 0.1\n", "= 'a'\n"), "tuned.toml: sigma.proximeter_0 must be a number"),
        (TUNED.replace("= 0.1\n", "= 0\n"), "sigma_proximeter_0 must be in [1e-06, 1e+06]; got 0"),
        (TUNED.replace("0.03", "3"), "theta_i must be in [0, 1]; got 3"),
    ],
)
def test_a_mistake_in_tuned_parameters_is_told(tmp_path, capsys, text, message):
    config, out = write(tmp_path, SMALL), tmp_path / "out"
    tuned = write(tmp_path, text, "tuned.toml")
    assert cli.main(["run", str(config), "--params", str(tuned), "--out", str(out)]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
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

    config = write(tmp_path, "records = [3, 20]\n" + SMALL)
    assert cli.main(["run", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "records: there is no 20; they are 0 to 19 (of" in capsys.readouterr().err

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


def test_progress_is_told_in_lines_where_there_is_no_terminal(capsys):
    """Every tenth of the runs: what came of them, how fast it goes, and how long it will."""
    tell, outcome, duration = cli._Progress(20), np.full(20, "", "<U2"), np.zeros(20)
    outcome[:6], duration[:6] = "S", 100  # from an earlier sitting
    tell(outcome, duration)
    assert capsys.readouterr().err == ""
    outcome[6:9], duration[6:10] = ["S", "Fs", "Fb"], 50
    tell(outcome, duration)
    (line,) = capsys.readouterr().err.splitlines()
    assert re.fullmatch(
        r"9 of 20 runs: S 7, Fs 1, Fg 0, Fb 1; \d+ simulated s a second, \d+ s left", line
    )
    tell(outcome, duration)
    assert capsys.readouterr().err == ""
