import re
import time

import numpy as np

from jaxreplay.study.progress import Progress

PLANE = ("S", "Fs", "Fg", "Fb"), "simulated s/s"


def test_progress_is_shown_in_lines_where_there_is_no_terminal(capsys, monkeypatch):
    """Every tenth of the work: what came of the runs, how fast it goes, and how long it will."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    show, outcome, duration = Progress(20, 180, *PLANE), np.full(20, "", "<U2"), np.zeros(20)
    outcome[:6], duration[:6] = "S", 100  # from an earlier call
    show(outcome, duration)
    assert capsys.readouterr().err == ""
    now[0] = 2.0
    outcome[6:9], duration[6:9] = ["S", "Fs", "Fb"], 100
    duration[9] = 50
    show(outcome, duration)
    (line,) = capsys.readouterr().err.splitlines()
    # 350 s simulated in 2 s; 950 of an expected 2,000 s are done
    want = "9 of 20 runs, 00:06 left: S 7, Fs 1, Fg 0, Fb 1; 175 simulated s/s"
    assert re.fullmatch(f"4[78] % of the simulated time: {re.escape(want)}", line)
    show(outcome, duration)
    assert capsys.readouterr().err == ""
    outcome[:], duration[:] = "S", 100
    show(outcome, duration)
    assert capsys.readouterr().err.startswith("100 % of the simulated time: 20 of 20 runs: S 20,")


def test_progress_counts_simulated_seconds_before_any_run_has_ended(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    show, outcome, duration = Progress(4, 180, *PLANE), np.full(4, "", "<U2"), np.zeros(4)
    show(outcome, duration)
    now[0] = 3.0
    show(outcome, duration + 45)
    assert "25 % of the simulated time: 0 of 4 runs: S 0," in capsys.readouterr().err


def test_progress_is_complete_only_when_all_runs_have_ended(capsys, monkeypatch):
    """The first run to end is the shortest: the others have lasted as long, and are not done."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    show, outcome, duration = Progress(10, 180, *PLANE), np.full(10, "", "<U2"), np.zeros(10)
    show(outcome, duration)
    now[0], outcome[0] = 3.0, "S"
    show(outcome, duration + 40)
    # 400 s simulated in 3 s; 90 of another 9 × 10 s are expected
    assert re.search("8[12] % .*: 1 of 10 runs, 00:00 left: S 1,", capsys.readouterr().err)
    duration[0], duration[1:] = 40, 180
    show(outcome, duration)
    assert capsys.readouterr().err.startswith("99 % of the simulated time: 1 of 10 runs, ")
    outcome[1:] = "Fs"
    show(outcome, duration)
    assert capsys.readouterr().err.startswith("100 % of the simulated time: 10 of 10 runs: S 1,")
