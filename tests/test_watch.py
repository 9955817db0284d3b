import re

import jax
import numpy as np
import pytest
from PIL import Image

from jaxreplay import Params, Records, cli, reference
from jaxreplay.plane.demonstrator import DEMONSTRATED, facing, record
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.params import SENSOR_RANGES, PlaneParams
from jaxreplay.watch import View, animate, beliefs, frames, watched

SIGMA = 0.1 * np.array(SENSOR_RANGES)


@pytest.fixture(scope="module")
def run():
    """A short one: the records end as the robot begins to advance."""
    sensors, commands = record(PlaneParams(), DEMONSTRATED[:6], 3)[0].sequences()
    records = Records.from_sequences([s[:90] for s in sensors], [c[:90] for c in commands])
    params = Params([0.1], [0.05], SIGMA[None])
    options = {"cube": facing(np.array([[0.3, -0.08]]))}
    return records, params, watched(records, params, PlaneVectorEnv(1), "own_tau", 5, options)


def test_it_is_all_that_happened(run):
    *_, seen = run
    n = seen.replays.steps[0]
    assert n == len(seen.poses) == len(seen.held) == len(seen.observations) == len(seen.commands)
    assert seen.replays.ending[0] == "completed"
    assert seen.poses[0].robot[0, 0] == 0
    turned = np.array([pose.robot[0, 2] for pose in seen.poses])
    assert np.ptp(turned) > 0.01  # each pose is of its own step
    np.testing.assert_array_equal(seen.observations[0, 1:], 0)


def test_the_beliefs_are_the_references(run):
    records, params, seen = run
    one = jax.tree.map(lambda x: x[0], params)
    belief = beliefs(records, one, "own_tau", seen.observations)
    sensors = [s.astype(float) for s in records.sequences()[0]]
    wanted = reference.initial(sensors)
    for t, z in enumerate(seen.observations):
        wanted = reference.predict(sensors, 0.1, 0.05, wanted, "own_tau")
        wanted, _ = reference.update(sensors, np.asarray(one.sigma, float), wanted, z.astype(float))
        np.testing.assert_allclose(belief[t], np.exp(wanted), atol=1e-5)


def test_frames_keep_the_pace_and_show_the_end():
    assert frames(21, 1.0) == [*range(20), 20]
    assert frames(21, 4.0) == [0, 4, 8, 12, 16, 20]
    assert frames(21, 1000.0) == [0, 20]
    assert frames(3, 0.5) == [0, 1, 2]
    assert frames(1, 4.0) == [0]


def test_an_animation_and_a_still(run, tmp_path):
    records, params, seen = run
    belief = beliefs(records, jax.tree.map(lambda x: x[0], params), "own_tau", seen.observations)
    told = []
    for name in ("run.gif", "run.png"):
        animate(seen, belief, records, "a run", tmp_path / name, 20, lambda *at: told.append(at))
    with Image.open(tmp_path / "run.gif") as gif, Image.open(tmp_path / "run.png") as still:
        wanted = len(frames(len(seen.poses), 20))
        assert gif.n_frames == wanted
        assert told == [(k + 1, wanted) for k in range(wanted)] + [(1, 1)]
        first = np.asarray(gif.convert("RGB"), int)
        gif.seek(wanted - 1)
        last = np.asarray(gif.convert("RGB"), int)
        assert np.abs(last - first).max() > 100
        np.testing.assert_allclose(last, np.asarray(still.convert("RGB"), int), atol=40)


@pytest.mark.parametrize("lit", [False, True])
def test_all_sensors_are_drawn_and_the_light_where_there_is_one(run, lit):
    records, params, seen = run
    belief = beliefs(records, jax.tree.map(lambda x: x[0], params), "own_tau", seen.observations)
    light = np.full((len(seen.observations), int(lit)), 0.7)
    view = View(
        seen._replace(observations=np.hstack([seen.observations, light])), belief, records, ""
    )
    view.show(5)
    drawn = {line.get_label(): line.get_ydata() for line, _ in view.lines}
    np.testing.assert_array_equal(drawn["camera"], seen.observations[:6, 0])
    np.testing.assert_array_equal(drawn["proximeter 5"], seen.observations[:6, 6])
    assert ("light" in drawn) == lit
    assert not lit or np.all(drawn["light"] == 0.7)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no.toml"], r"no\.toml: cannot be read"),
        (["{config}", "--run", "1000"], "the study has 15 runs; give 0 to 14"),
        (["{config}", "--run", "Fx"], "give a run's number, or one of S, Fs, Fg, Fb, fixed"),
        (["{config}", "--run", "S"], "how runs ended is known once they are run"),
        (["{config}", "--out", "run.mp4"], r"let its name end in \.gif, or in \.png"),
        (["{folder}"], r"study\.json is missing"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text("theta_i = 0.1")
    named = [a.format(config="study.toml", folder=str(tmp_path)) for a in arguments]
    assert cli.main(["watch", *named]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1

    assert re.search(message, said)
    assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]
