"""The page of one run, also in a real browser where Chromium and playwright are installed."""

import io
import json
import re
from base64 import b64decode
from gzip import decompress

import numpy as np
import pytest
from PIL import Image
from trace_helpers import STEPS, trace

from jaxreplay.errors import ConfigError
from jaxreplay.page.run import MOST_BYTES, Followed, beams, page
from jaxreplay.pictures import Watched
from jaxreplay.plane.drawing import Scene
from jaxreplay.plane.sensors import Pose
from jaxreplay.records import Records
from jaxreplay.study.dataset import Pictures, Trace

SAFE = "own </script><b>&"


def about(text):
    """Return the description in a page, and its arrays by name."""
    found = json.loads(re.search(r'id="about">(.*?)</script>', text, re.DOTALL).group(1))
    raw, arrays = decompress(b64decode(found["data"]["packed"])), {}
    for name, dtype, shape, offset in found["data"]["arrays"]:
        count = int(np.prod(shape))
        arrays[name] = np.frombuffer(raw, dtype, count, offset).reshape(shape)
    return found, arrays


def pictures():
    """Return a picture for each step, a third of them alike."""
    files = []
    for t in range(STEPS):
        file = io.BytesIO()
        Image.new("RGB", (600, 400), (t // 3, 90, 0)).save(file, "PNG")
        files.append(file.getvalue())
    return Pictures(files)


def long_run(steps, n, longest):
    rng = np.random.default_rng(1)
    beliefs = rng.dirichlet(np.full(n * longest, 0.02), 40).reshape(40, n, longest)
    sequences = [np.zeros((longest, 12))] * n, [np.zeros((longest, 3))] * n
    return Trace(
        observations=rng.normal(size=(steps, 12)),
        commands=rng.normal(size=(steps, 3)),
        beliefs=np.resize(beliefs, (steps, n, longest)).astype(np.float32),
        records=Records.from_sequences(*sequences),
        ending="Fs",
        period=None,
        scene=None,
    )


def test_a_page_contains_the_run():
    run = trace()
    found, arrays = about(page(run, 2.0))
    assert (found["ending"], found["speed"]) == ("S, error 2.3 mm", 2.0)
    np.testing.assert_array_equal(arrays["step"], np.arange(1, STEPS + 1))
    np.testing.assert_allclose(arrays["sensors"], run.observations, rtol=1e-6)
    np.testing.assert_allclose(arrays["robot"], run.scene.robot, rtol=1e-6)
    np.testing.assert_allclose(arrays["share"] / 65535, run.beliefs.sum(axis=2), atol=1e-5)
    shown = (arrays["belief"].reshape(STEPS, 3, -1) / 255.0) ** 4
    np.testing.assert_allclose(shown.sum(axis=(1, 2)), 1, atol=0.05)
    assert found["run"]["ends"] == [8, 6, 7]


def test_beams_are_those_of_the_other_pictures():
    import matplotlib.pyplot as plt

    scene = trace().scene
    pose = Pose(scene.robot, scene.cube, scene.elevation, scene.tilt)
    drawn = Scene(plt.figure().add_subplot(), scene.params)
    for t in (0, STEPS - 1):
        drawn.update(Pose(*(each[t : t + 1] for each in pose)), False, scene.robot[:1, :2])
        segments = np.array(drawn._beams.get_segments()).reshape(-1, 4)
        np.testing.assert_allclose(100 * beams(scene.params, pose)[t], segments, atol=1e-9)
    plt.close("all")


def test_a_jump_is_to_a_record_twice_as_probable_as_the_one_followed():
    shares = np.array([[0.6, 0.4], [0.4, 0.6], [0.3, 0.7], [0.5, 0.5], [0.65, 0.35], [0.7, 0.3]])
    followed = Followed()
    assert [followed.jumps(p) for p in shares] == [False, False, True, False, False, True]


def test_samples_not_measured_are_drawn_as_gaps():
    run = trace()
    run.observations[:3, 0] = np.nan
    run.observations[:, 1] = np.nan
    found, arrays = about(page(run))
    scales = found["run"]["sensors"]
    assert scales["low"][0] == pytest.approx(run.observations[3:, 0].min())
    assert (scales["low"][1], scales["span"][1]) == (0, 1)
    assert np.isnan(arrays["sensors"][:3, 0]).all()


@pytest.mark.parametrize(("steps", "n", "longest"), [(5000, 8, 90), (700, 80, 500)])
def test_a_page_of_a_long_run_or_of_many_records_stays_small(steps, n, longest):
    run = long_run(steps, n, longest)
    text = page(run)
    assert len(text.encode()) <= MOST_BYTES
    found, arrays = about(text)
    assert arrays["step"][-1] == steps
    assert len(found["run"]["rows"]) == min(n, 60)
    assert len(arrays["belief"]) == len(arrays["step"])
    assert found["run"]["sensors"]["scale"].endswith("(10 of 12)")


def test_the_suffix_says_what_is_saved(tmp_path):
    watched = Watched(trace(), 40)
    for suffix in ("html", "gif", "png"):
        watched.save(tmp_path / f"run.{suffix}")
    assert (tmp_path / "run.html").read_text("utf-8").startswith("<!doctype html>")
    assert (tmp_path / "run.gif").read_bytes().startswith(b"GIF89a")
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match=r"run\.mp4: its name must end in \.html for a page"):
        watched.save(tmp_path / "run.mp4")
    assert watched._repr_html_().startswith('<iframe srcdoc="&lt;!doctype html&gt;')


@pytest.fixture(params=["plane", "pictures", "numbers"])
def shown(request, browser, tmp_path):
    """A page in the browser; nothing is asked of a network, and nothing goes wrong."""
    run = trace()._replace(values={"controller": SAFE, "θ_I": 0.001})
    if request.param != "plane":
        run = run._replace(scene=pictures() if request.param == "pictures" else None)
    (tmp_path / "run.html").write_text(page(run, 1.0), "utf-8")
    tab, wrong = browser.new_page(viewport={"width": 1280, "height": 720}), []
    tab.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    tab.on("pageerror", lambda error: wrong.append(f"{error}"))
    tab.on("request", lambda asked: wrong.append(asked.url) if asked.url[:4] == "http" else None)
    tab.goto((tmp_path / "run.html").as_uri())
    tab.wait_for_function("document.getElementById('clock').textContent !== ''")
    yield tab
    assert not wrong
    tab.close()


def ink(tab, figure):
    """Return how many pixels of a figure's canvas are drawn on."""
    return tab.evaluate(
        "id => { const c = document.querySelector(`#${id} canvas`); return c.width * c.height &&"
        " c.getContext('2d').getImageData(0, 0, c.width, c.height).data"
        ".filter((v, k) => k % 4 === 3 && v > 0).length }",
        figure,
    )


def test_a_run_is_played_and_scrubbed_in_a_browser(shown):
    clock, reading = shown.locator("#clock"), shown.locator("#reading")
    assert clock.inner_text() == "0.1 s"
    assert SAFE in shown.locator("header").inner_text()
    assert "End" not in reading.inner_text()
    before = {name: ink(shown, name) for name in ("now", "past", "sensors", "commands")}
    shown.keyboard.press("ArrowRight")
    shown.keyboard.press("Shift+ArrowRight")
    shown.keyboard.press("ArrowLeft")
    assert clock.inner_text() == "1.1 s"
    shown.keyboard.press("+")
    shown.keyboard.press("Space")
    shown.wait_for_function("document.getElementById('scrubber').value > 40")
    shown.keyboard.press("Space")
    assert shown.locator("#play").inner_text() == "Play"
    shown.keyboard.press("End")
    assert clock.inner_text() == "9.0 s"
    assert reading.inner_text().endswith("End: S, error 2.3 mm")
    assert all(ink(shown, name) > 1.02 * old for name, old in before.items() if name != "now")
    world = shown.locator("#world")
    if world.is_visible():
        assert ink(shown, "world") > 5000
    shown.locator("#scrubber").fill("29")
    assert clock.inner_text() == "3.0 s"
    box = shown.locator("#past canvas").bounding_box()
    shown.mouse.click(box["x"] + 34 + (box["width"] - 48) / 2, box["y"] + 20)
    assert clock.inner_text() in ("4.4 s", "4.5 s")
    shown.emulate_media(color_scheme="dark")
    assert shown.locator("#clock").is_visible()
