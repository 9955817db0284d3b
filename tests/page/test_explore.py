"""`jaxreplay explore`: its server, and its page in a real browser."""

import http.client
import json
import os
import re
import signal
import subprocess
import sys
from time import monotonic

import numpy as np
import pytest
from line_world import of_line
from study_helpers import beginnings

from jaxreplay import cli, open_study, read
from jaxreplay.errors import ConfigError
from jaxreplay.explore import drive
from jaxreplay.explore.cells import picture
from jaxreplay.explore.live import (
    CancelledError,
    asked,
    controls,
    stream,
    titled,
    values_of,
)
from jaxreplay.plane.params import PlaneParams
from jaxreplay.study.config import load_config
from jaxreplay.study.demonstrations import demonstrations

STUDY = """
theta_tau = 0.05
demonstrations = "records.npz"
positions = [[0.3, 0.05], [0.3, -0.05]]
repeats = 1
[axis]
theta_i = [0.1, 0.001]
[plane]
time_limit = 6.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a study of four short runs."""
    made = tmp_path_factory.mktemp("explored")
    beginnings().save(made / "records.npz")
    (made / "study.toml").write_text(STUDY)
    assert cli.main(["run", f"{made / 'study.toml'}", "--out", f"{made / 'out'}"]) == 0
    return made


@pytest.fixture
def served(folder):
    """The process and its address: host, port, token."""
    command = [sys.executable, "-m", "jaxreplay", "explore", "out", "--no-browser"]
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    address = process.stdout.readline().strip()
    yield process, *re.fullmatch(r"http://(127\.0\.0\.1):(\d+)/([\w-]{20,})/", address).groups()
    process.kill()
    process.communicate()


def status(port, path, **headers):
    """The status and text of an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=10)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode() if answer.status != 101 else ""
    connection.close()
    return answer.status, text


def test_nobody_else_is_answered(served):
    process, _, port, token = served
    code, text = status(port, f"/{token}/")
    assert code == 200
    assert text.startswith("<!doctype html>")
    assert not re.search(r"(src|href)=.?(http|//)", text)
    assert status(port, "/") == (404, "404\n")
    assert status(port, f"/{token[:-1]}x/") == (404, "404\n")
    assert status(port, f"/{token[:-1]}x/live") == (404, "404\n")
    assert status(port, f"/{token}/", Host=f"rebound.example:{port}") == (403, "403\n")
    assert status(port, f"/{token}/", Origin="http://evil.example") == (403, "403\n")

    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    upgrade["Sec-WebSocket-Key"] = "dGhlIHNhbXBsZSBub25jZQ=="
    live = f"/{token}/live"
    assert status(port, live, **upgrade, Origin=f"http://127.0.0.1:{port}")[0] == 101
    assert status(port, live, **upgrade, Origin="http://evil.example")[0] == 403
    assert status(port, live, **upgrade, Host=f"rebound.example:{port}")[0] == 403
    assert status(port, f"/{token[:-1]}x/live", **upgrade)[0] == 404
    process.send_signal(signal.SIGINT)
    assert process.wait(5) == 130
    assert process.stderr.read().strip() == "jaxreplay: interrupted"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere"),
        (["--port", "99999"], "--port: must be a whole number up to 65535"),
        (["--port", "{taken}"], "choose another, or none"),
    ],
)
def test_a_mistake_is_one_line(served, capsys, arguments, message):
    given = [argument.format(taken=served[2]) for argument in arguments]
    try:
        code = cli.main(["explore", "--no-browser", *given])
    except SystemExit as stopped:
        code = stopped.code
    assert code == 2
    assert message in capsys.readouterr().err.splitlines()[-1]


def test_cells_and_values_are_those_of_the_study(folder):
    study = open_study(folder / "out")
    cells = picture(study)
    assert (cells["rows"], cells["columns"]) == ([""], ["θ_I 0.1", "θ_I 0.001"])
    shown = [cell["outcomes"] for cell in cells["cells"][0]]
    np.testing.assert_array_equal(shown, study.outcome.values.reshape(2, 2))
    assert [cell["first"] for cell in cells["cells"][0]] == [0, 2]
    config = load_config(folder / "study.toml")
    values = values_of(config, 3)
    assert (values["theta_i"], values["position"], values["cube"]) == (0.001, 1, [0.3, -0.05])
    assert titled(config, values) == "θ_I 0.001, position 1, repeat 0"
    one, k = asked(config, {**values, "theta_i": 0.2, "cube": [0.33, 0.0]})
    assert values_of(one, k) == {**values, "theta_i": 0.2, "cube": [0.33, 0.0]}
    more, k = asked(config, {**values, "repeat": 7})
    assert values_of(more, k) == {**values, "repeat": 7}
    with pytest.raises(ConfigError, match="theta_i"):
        asked(config, {**values, "theta_i": 2})


def test_what_can_be_changed_has_an_effect_and_includes_the_studys_values(folder):
    config = load_config(folder / "study.toml", ["sigma_proximeter_1=0.3", "motor_unit=0.03"])
    found = {each["name"]: each for each in controls(config, values_of(config, 0))}
    assert {"sigma_camera", "sigma_proximeters", "sigma_proximeter_1"} < found.keys()
    assert "sigma" not in found
    assert found["motor_unit"]["choices"][-1] == 0.03
    assert found["theta_i"]["range"][0] == -6
    config = load_config(folder / "study.toml", ["axis.theta_i=[1e-25, 0.0]"])
    assert controls(config, values_of(config, 0))[0]["range"][0] == -25


def test_slow_keys_still_turn_and_orders_are_keys(monkeypatch):
    hand, unit = driver(monkeypatch, []), PlaneParams().motor_unit
    for keys, units in (
        (["w"], [3, 3]), (["w", "shift"], [1, 1]), (["A", "Shift"], [-1, 1]),
        (["arrowup", "d", "shift"], [2, 1]), (["w", "s"], [0, 0]),
    ):  # fmt: skip
        hand.press(keys, [])
        np.testing.assert_allclose(hand.command()[:2], unit * np.array(units))


def test_an_environments_run_is_sent_with_its_pictures_and_can_be_ended(tmp_path):
    line = of_line(tmp_path)
    config, sent = load_config(line), []
    values = values_of(config, 0)
    one, k = asked(config, {**values, "theta_i": 0.3})
    records = demonstrations(one, tmp_path)
    run = stream(one, records, k, "a title", sent.append, lambda: True)
    assert run.values["θ_I"] == 0.3
    first, *steps = sent
    assert first["run"]["title"] == "a title"
    assert sum(len(step["pictures"]) for step in steps) == len(run.commands)
    json.dumps(sent, allow_nan=False)
    with pytest.raises(CancelledError):
        stream(one, records, k, "", sent.append, lambda: False)


def driver(monkeypatch, sent):
    monkeypatch.setattr(drive, "sleep", lambda seconds: None)
    return drive.Driver(PlaneParams(), sent.append)


def test_demonstrations_by_hand_are_records_that_a_study_replays(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sent = []
    hand = driver(monkeypatch, sent)
    with pytest.raises(ConfigError, match="no demonstration has been kept"):
        hand.save("mine")
    for k in range(5):
        begun = len(sent)

        def go(begun=begun, k=k):  # what is pressed after so many steps
            steps = len(sent) - begun
            if steps == 3:
                hand.press(["W"] if k else ["ArrowUp", "Shift"], ["r", "t"])
            if steps == 40:
                hand.press([], ["m"])
                hand.order("keep")
            return True

        hand.demonstrate(go)
    assert sent[-1]["ending"] == "kept, the cube is not lifted"
    assert sent[-1]["note"] == "kept; 5 kept: 5 s, 5 s, 5 s, 5 s, 5 s"
    assert "saved 5 in mine.npz" in hand.save("mine")
    for name, message in (("mine", "exists"), ("../mine", "give a name of letters")):
        with pytest.raises(ConfigError, match=message):
            hand.save(name)
    records = read("mine.npz")
    _, commands = records.sequences()
    assert {len(rows) for rows in commands} == {50}
    unit, p = PlaneParams().motor_unit, PlaneParams()
    np.testing.assert_allclose(commands[0][10], [unit, unit, p.low, p.scanning_tilt, 0], rtol=1e-6)
    np.testing.assert_allclose(commands[1][10, :2], 3 * unit, rtol=1e-6)
    np.testing.assert_allclose(commands[1][-10:, :2], 0)
    assert commands[1][-1, 4] == 1
    study = "theta_i = 0.1\nrepeats = 1\npositions = [[0.3, 0.0]]\ndemonstrations = 'mine.npz'\n"
    (tmp_path / "study.toml").write_text(study)
    assert cli.main(["run", "study.toml"]) == 0
    capsys.readouterr()
    assert open_study("results/study").duration.item() < 8  # as long as what was shown


def test_what_is_discarded_or_left_is_not_kept(monkeypatch):
    sent = []
    hand = driver(monkeypatch, sent)
    hand.demonstrate(lambda: len(sent) < 5)
    assert sent[-1]["ending"] == "stopped, the cube is not lifted"
    begun = len(sent)

    def go():
        if len(sent) == begun + 4:
            hand.order("discard")
        return True

    hand.demonstrate(go)
    assert sent[-1]["ending"] == "discarded, the cube is not lifted"
    assert not hand.kept


def until(tab, test, seconds=60):
    """Wait for something; the page allows no evaluation of strings, so not in the page."""
    began = monotonic()
    while not test():
        assert monotonic() < began + seconds
        tab.wait_for_timeout(20)
    return monotonic() - began


def test_a_study_is_seen_asked_and_driven_in_a_browser(served, browser, folder):
    _, host, port, token = served
    tab, wrong = browser.new_page(viewport={"width": 1280, "height": 720}), []
    tab.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    tab.on("pageerror", lambda error: wrong.append(f"{error}"))
    tab.goto(f"http://{host}:{port}/{token}/")
    clock, said = tab.locator("#clock"), tab.locator("#said")
    # Study: from cell to run
    tab.locator("td button").nth(1).click()
    assert tab.locator("aside").inner_text().count("S ") >= 1
    tab.locator(".runs button").nth(0).click()
    until(tab, lambda: said.inner_text() == "as in the study", 120)
    assert tab.locator("header").inner_text().strip() == "run 2: θ_I 0.001, position 0, repeat 0"
    tab.keyboard.press("End")
    assert "End: " in tab.locator("#reading").inner_text()
    before = tab.locator("#past canvas").screenshot()
    # Ask: another θ_I, in the same world
    tab.get_by_role("button", name="Ask").click()
    assert tab.locator("input[name=theta_i]").input_value() == "-3"
    shown = tab.locator("label", has=tab.locator("input[name=theta_i]")).locator("output")
    assert shown.inner_text() == "0.001"
    tab.locator("input[name=theta_i]").fill("-5")
    assert shown.inner_text() == "1e-5"
    tab.locator("input[name=theta_i]").fill("-0.5")
    until(tab, lambda: "as asked for" in tab.locator("header").inner_text())
    until(tab, lambda: clock.inner_text() != "")
    tab.keyboard.press("End")
    until(tab, lambda: tab.keyboard.press("End") or "End: " in tab.locator("#reading").inner_text())
    assert tab.locator("#past canvas").screenshot() != before
    # … and with the cube elsewhere: from 30 cm ahead and 5 to the left it is dragged straight ahead
    tab.keyboard.press("Home")
    box, area = tab.locator("#world canvas").bounding_box(), PlaneParams().area
    scale = min(
        (box["width"] - 48) / (area[1] - area[0]), (box["height"] - 36) / (area[3] - area[2])
    )
    left = box["x"] + 34 + (box["width"] - 48 - scale * (area[1] - area[0])) / 2

    def at(x, y):
        return left + scale * (x - area[0]), box["y"] + 4 + scale * (area[3] - y)

    before = tab.locator("#world canvas").screenshot()
    tab.mouse.move(*at(0.3, 0.05))
    tab.mouse.down()
    tab.mouse.move(*at(0.33, 0.02), steps=3)
    tab.mouse.move(*at(0.36, -0.1), steps=3)
    assert tab.locator("#world canvas").screenshot() != before
    tab.mouse.up()
    until(tab, lambda: tab.evaluate("() => frames.length > 0 && frames[0].cube[0] > 0.35"))
    assert tab.evaluate("() => frames[0].cube[1]") == pytest.approx(-0.1, abs=0.01)
    # Drive: by key events, until it is kept and saved
    tab.get_by_role("button", name="Drive").click()
    tab.get_by_role("button", name="Start").click()
    until(tab, lambda: clock.inner_text() in ("0.2 s", "0.3 s", "0.4 s"))
    tab.keyboard.down("w")
    until(tab, lambda: float(clock.inner_text().split()[0]) > 1.5)
    tab.keyboard.up("w")
    tab.keyboard.press("r")
    tab.keyboard.press("Enter")
    until(tab, lambda: said.inner_text().startswith("kept; 1 kept: "))
    tab.locator("input[name=name]").fill("by_hand")
    tab.get_by_role("button", name="Save").click()
    until(tab, lambda: "saved 1 in by_hand.npz" in said.inner_text())
    _, (commands,) = read(folder / "by_hand.npz").sequences()
    assert 0.8 < (commands[:, :2] == np.float32(0.03)).all(axis=1).sum() / 10 < 3  # s
    assert commands[-1, 2] == np.float32(PlaneParams().low)
    tab.close()
    assert not wrong
    assert os.listdir(folder).count("by_hand.npz") == 1
