"""Studies in environments that are not the plane."""

from io import BytesIO

import gymnasium
import numpy as np
import pytest
import xarray as xr
from gymnasium.vector import AutoresetMode
from line_world import LINE
from PIL import Image
from study_helpers import TUNED, write

import jaxreplay as jr
from jaxreplay import cli
from jaxreplay.errors import ConfigError
from jaxreplay.loop.replay import Replays
from jaxreplay.plane.options import seed_of
from jaxreplay.study.config import load_config
from jaxreplay.study.dataset import Pictures
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.open import config_of
from jaxreplay.study.runs import runs_of, settings_of
from jaxreplay.study.worlds.environment import Environment

CAR = """
environment = "MountainCarContinuous-v0"
success_return = 80
last_steps = 0
repeats = 3
[demonstrations]
file = ["car_0.csv", "car_1.csv"]
sensors = ["position", "velocity"]
commands = "force"
[axis]
controller = ["filter", "tape"]
theta_i = [0.1]
"""


def climb(seed):
    """Positions, velocities and forces of a car that pushes where it rolls, until it is up."""
    car = gymnasium.make("MountainCarContinuous-v0").unwrapped
    z, _ = car.reset(seed=seed)
    rows, up = [], False
    while not up:
        force = 1.0 if z[1] >= 0 else -1.0
        z, _, up, *_ = car.step(np.array([force], np.float32))
        rows.append([*z, force])
    return np.array(rows)


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    """A folder with a study of Gymnasium's car, its demonstrations as CSV, and its results."""
    folder = tmp_path_factory.mktemp("car")
    for seed in range(2):
        np.savetxt(
            folder / f"car_{seed}.csv", climb(seed), "%.9g", ",", comments="",
            header="position,velocity,force",
        )  # fmt: skip
    path = write(folder, CAR, "car.toml")
    assert cli.main(["run", str(path), "--out", str(folder / "out")]) == 0
    return path


def test_a_study_of_a_stock_environment_is_run_and_drawn(car, capsys):
    """Its runs are those that `replay` makes of the same records, parameters and seeds."""
    study = jr.open_study(car.parent / "out")
    assert study.outcome.dims == ("controller", "theta_i", "repeat")
    assert (study.outcome == "S").all()
    records = jr.read(
        [car.parent / "car_0.csv", car.parent / "car_1.csv"], ["position", "velocity"], "force"
    )
    span = np.ptp(np.vstack(records.sequences()[0]), axis=0)
    how = {
        "vectorization_mode": "sync",
        "vector_kwargs": {"autoreset_mode": AutoresetMode.DISABLED},
    }
    for name in ("filter", "tape"):
        done = jr.replay(
            records, jr.Params(0.1, 0.05, 0.1 * span),
            gymnasium.make_vec("MountainCarContinuous-v0", 3, **how),
            [seed_of(0, 0, repeat, 1) for repeat in range(3)],
            last_steps=None, controller=name,
        )  # fmt: skip
        ours = study.sel(controller=name, theta_i=0.1)
        np.testing.assert_array_equal(ours.duration, done.steps)
        np.testing.assert_allclose(ours["return"], done.reward, rtol=1e-6)
        np.testing.assert_allclose(ours.distance, done.distance_median, rtol=1e-4)
    for suffix in ("png", "pdf"):
        assert (car.parent / "out" / f"outcomes.{suffix}").stat().st_size > 5000
    assert cli.main(["show", str(car.parent / "out")]) == 0
    head, first, *_ = capsys.readouterr().out.splitlines()
    assert head.split()[:6] == ["controller", "θ_I", "S", "Fs", "Fe", "Ft"]
    assert "return" in head
    assert "duration of S, steps" in head
    assert "lifted" not in head
    assert first.split()[:6] == ["filter", "0.1", "3", "0", "0", "0"]
    assert cli.main(["show", str(car.parent / "out"), "--csv"]) == 0
    names = capsys.readouterr().out.splitlines()[0].split(",")
    assert names[:6] == ["controller", "theta_i", "repeat", "outcome", "return", "duration"]
    with pytest.raises(ValueError, match="needs a study on the plane"):
        jr.plot_map(study)


def test_it_is_resumed_and_other_settings_are_another_study(car, capsys):
    out = car.parent / "out"
    before = jr.open_study(out)
    (lost,) = out.glob("shards/00001.nc")
    lost.unlink()
    assert (jr.open_study(out).outcome == "").sum() == 3
    assert cli.main(["run", str(car), "--out", str(out)]) == 0
    xr.testing.assert_identical(jr.open_study(out), before)
    config = config_of(before)
    assert config == load_config(car)
    assert (config.positions, config.repeats) == ((), 3)
    capsys.readouterr()
    assert cli.main(["run", str(car), "--out", str(out), "--set", "success_return=70"]) == 2
    assert "another study, which differs in config.success_return" in capsys.readouterr().err


def test_it_is_resumed_from_another_folder_and_with_moved_demonstrations(line, monkeypatch, capsys):
    out, changes = line.parent / "out", ["--set", "repeats=1"]
    assert cli.main(["run", str(line), "--out", str(out), *changes]) == 0
    monkeypatch.chdir(line.parent)
    assert cli.main(["run", "line.toml", "--out", "out", *changes]) == 0
    (line.parent / "line.npz").rename("moved.npz")
    moved = [*changes, "--set", "demonstrations=moved.npz"]
    assert cli.main(["run", "line.toml", "--out", "out", *moved]) == 0
    jr.read("moved.npz").subset([0]).save("moved.npz")
    capsys.readouterr()
    assert cli.main(["run", "line.toml", "--out", "out", *moved]) == 2
    assert "another study, which differs in demonstrations;" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "outcome"),
    [
        ("", "S"),
        ("goal = 5.0", "Fe"),
        ("edge = 0.5", "Ft"),
        ("max_episode_steps = 9", "Fs"),
        pytest.param("edge = 1.05", "S", marks=pytest.mark.slow),
        pytest.param("max_episode_steps = 15", "S", marks=pytest.mark.slow),
    ],
)
def test_how_runs_end(line, arguments, outcome):
    """The environment's info says whether a run succeeded; the ending says how else it ended."""
    text = LINE.replace('"line_world:Line-v0"', f'{{id = "line_world:Line-v0", {arguments}}}')
    line.write_text(text.replace(", }", "}"))
    study = jr.run_study(load_config(line), line.parent / "out", lambda *so_far: None)
    assert study.outcome.values.ravel().tolist() == 2 * [outcome]


def test_success_by_return_is_at_least_that():
    ending = np.array(["terminated", "completed", "truncated", ""])
    for least, codes in ((1.0, ["S", "S", "S", ""]), (1.1, ["Ft", "Fe", "Fs", ""])):
        replays = _replays(ending, np.ones(4))
        assert Environment("x", success_return=least).outcome(replays).tolist() == codes
    told = _replays(ending, np.zeros(4), success=np.array([1.0, np.nan, 0.0, 1.0]))
    assert Environment("x").outcome(told).tolist() == ["S", "Fe", "Fs", ""]
    with pytest.raises(ConfigError, match="give success_return, the least return of a success"):
        Environment("x").outcome(_replays(ending, np.zeros(4)))
    running = _replays(np.array(["", ""]), np.zeros(2))
    assert Environment("x").outcome(running).tolist() == ["", ""]


def _replays(ending, reward, **info):
    some = np.zeros(len(ending))
    return Replays(ending, some, reward, some, info, some, some, some, some, {})


def test_a_sigma_is_a_share_of_its_sensors_range_in_the_records(line):
    config = load_config(line, ["axis.sigma_x=[0.2, 0.4]", "sigma=0.3"])
    assert config.world.factors["sigma_x"].symbol == "σ x"
    records = demonstrations(config, line.parent)
    params, seeds, options = settings_of(config, records, runs_of(config))
    assert options == {}
    assert len(set(seeds)) == 2  # as many as repeats: cells have their runs in common
    span = 1.205 - 0.1
    expected = [[0.2 * span, 0.3], [0.4 * span, 0.3]]  # a constant sensor's range counts as 1
    np.testing.assert_allclose(np.asarray(params.sigma)[::2], expected, rtol=1e-5)
    tuned = write(
        line.parent, "theta_i = 0.03\ntheta_tau = 0.2\n[sigma]\nx = 0.5\nseven = 2.0\n", "t.toml"
    )
    with pytest.warns(UserWarning, match=r"t\.toml takes the place of axis\.theta_i"):
        config = load_config(line, params=tuned)
    assert "theta_i" not in config.axes
    params, *_ = settings_of(config, records, runs_of(config))
    np.testing.assert_allclose(params.sigma, [[0.5, 2.0]] * 2, rtol=1e-6)
    assert not jr.StudyConfig({"theta_i": [0.1]}).fixed.keys() & {"sigma_x"}
    plain = write(line.parent, LINE.replace("[axis]\ntheta_i = [0.1]\n", ""), "plain.toml")
    with pytest.raises(ConfigError, match=r"--set sigma=0\.3 has no effect beside"):
        load_config(plain, ["sigma=0.3"], tuned)
    with pytest.raises(ConfigError, match=r"its sensors are camera.*; the study's are x, seven"):
        load_config(line, params=write(line.parent, TUNED, "plane.toml"))


def test_a_run_is_watched_with_the_environments_pictures(line, capsys):
    folder = line.parent
    jr.run_study(load_config(line), folder / "out", lambda *so_far: None)
    assert (
        cli.main(["watch", str(folder / "out"), "--run", "S", "--out", str(folder / "r.gif")]) == 0
    )
    shown = capsys.readouterr().out
    assert shown.startswith("S, return 1.")
    assert "repeat 0" in shown
    assert "position" not in shown
    assert (folder / "r.gif").read_bytes()[:4] == b"GIF8"
    assert cli.main(["watch", str(folder / "out"), "--run", "Fg"]) == 2
    assert "one of S, Fs, Fe, Ft, or values" in capsys.readouterr().err


def test_pictures_are_of_their_own_step_and_an_environment_without_them_is_still_watched(line):
    world = Environment("line_world:Line-v0")
    worlds = world.make(1, render=True)
    (x,), _ = worlds.reset(seed=[0])
    seen = []
    for _ in range(3):
        worlds.step(np.array([[0.3]]))
        seen.append(world.look(worlds))
    scene = world.scene(seen)
    assert isinstance(scene, Pictures)
    for k, file in enumerate(scene.files):
        (column,) = set(np.nonzero(np.asarray(Image.open(BytesIO(file)))[..., 0] == 0)[1])
        assert column == int(80 * (x[0] + 0.3 * (k + 1)))
    bare = world.make(1)
    bare.reset(seed=[0])
    assert world.scene([world.look(bare)]) is None
