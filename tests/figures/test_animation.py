import numpy as np
import pytest
from PIL import Image
from trace_helpers import STEPS, trace

from jaxreplay.figures.animation import animate, frames, still, title
from jaxreplay.figures.view import View
from jaxreplay.plane.params import SENSOR_NAMES
from jaxreplay.records import Records


@pytest.fixture(scope="module")
def run():
    return trace()


def test_the_title_says_which_run_it_is_and_how_it_ended(run):
    assert title(run) == "S, error 2.3 mm\nθ_I 0.001, J own_tau; position 3, repeat 1"


def test_frames_keep_the_pace_and_show_the_end():
    assert frames(21, 1.0, 0.1) == [*range(20), 20]
    assert frames(21, 4.0, 0.1) == [0, 4, 8, 12, 16, 20]
    assert frames(21, 1000.0, 0.1) == [0, 20]
    assert frames(3, 0.5, 0.1) == [0, 1, 2]
    assert frames(1, 4.0, 0.1) == [0]


def test_an_animation_and_a_still(run, tmp_path):
    progress = []
    animation = animate(run, 20, lambda *at: progress.append(at))
    animation.save(tmp_path / "run.gif")
    still(run).save(tmp_path / "run.png")
    assert len({tuple(frame.getpalette()) for frame in animation.frames}) == 1
    with Image.open(tmp_path / "run.gif") as gif, Image.open(tmp_path / "run.png") as last_one:
        wanted = len(frames(STEPS, 20, 0.1))
        assert gif.n_frames == wanted
        assert progress == [(k + 1, wanted) for k in range(wanted)]
        first = np.asarray(gif.convert("RGB"), int)
        gif.seek(wanted - 1)
        last = np.asarray(gif.convert("RGB"), int)
        assert np.abs(last - first).max() > 100
        np.testing.assert_allclose(last, np.asarray(last_one.convert("RGB"), int), atol=40)


def test_grey_pixels_of_a_frame_remain_grey(run, tmp_path):
    animate(run, 40).save(tmp_path / "run.gif")
    view = View(run)
    with Image.open(tmp_path / "run.gif") as gif:
        for k, t in enumerate(frames(STEPS, 40, 0.1)):
            gif.seek(k)
            view.show(t)
            drawn = np.asarray(view.picture(), int)
            stored = np.asarray(gif.convert("RGB"), int)
            grey = np.ptp(drawn, axis=2) == 0
            assert grey.mean() > 0.5
            assert np.ptp(stored[grey], axis=1).max() == 0
            assert np.abs(stored - drawn)[grey].max() <= 3


def test_tracks_with_equal_commands_are_both_visible(run):
    left, right = (line for line, _ in View(run).lines[7:9])
    assert (left.get_label(), right.get_label()) == ("left track", "right track")
    assert not left.is_dashed()
    assert right.is_dashed()


@pytest.mark.parametrize("lit", [False, True])
def test_all_sensors_are_drawn_and_the_light_where_there_is_one(run, lit):
    light = np.full((STEPS, int(lit)), 0.7)
    names = SENSOR_NAMES + lit * ("light",)
    records = Records.from_sequences([np.zeros((9, 7 + lit))], [np.zeros((9, 5))], names)
    seen = np.hstack([run.observations, light])
    view = View(run._replace(observations=seen, records=records))
    view.show(5)
    drawn = {line.get_label(): line.get_ydata() for line, _ in view.lines}
    seen = run.observations
    shares = (seen - seen.min(axis=0)) / np.ptp(seen, axis=0)  # each sensor on its own range
    np.testing.assert_allclose(drawn["camera"], shares[:6, 0])
    np.testing.assert_allclose(drawn["proximeter 5"], shares[:6, 6])
    assert ("light" in drawn) == lit
    assert not lit or np.all(drawn["light"] == 0)  # a constant is at its lowest value


def test_a_step_shows_its_own_belief_and_the_past_up_to_it(run):
    view = View(run)
    view.show(5)
    now = np.asarray(view.now.get_array())
    np.testing.assert_allclose(now**4, run.beliefs[5].reshape(3, 20, 4).sum(axis=2))
    past = np.asarray(view.past.get_array())
    np.testing.assert_allclose(past[:, :6], run.beliefs[:6].sum(axis=2).T)
    assert not past[:, 6:].any()
