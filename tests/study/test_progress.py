import re
import time

import numpy as np

from jaxreplay.study.progress import Progress


def test_progress_is_shown_in_lines_where_there_is_no_terminal(capsys, monkeypatch):
    """Every tenth of the work: what came of the runs, how fast it goes, and how long it will."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    show, outcome, duration = Progress(20, 180), np.full(20, "", "<U2"), np.zeros(20)
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
    assert line in (f"48 %: {want}", f"47 %: {want}")
    show(outcome, duration)
    assert capsys.readouterr().err == ""
    outcome[:], duration[:] = "S", 100
    show(outcome, duration)
    assert re.match("100 %: 20 of 20 runs, 00:00 left: S 20", capsys.readouterr().err)


def test_progress_counts_simulated_seconds_before_any_run_has_ended(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    show, outcome, duration = Progress(4, 180), np.full(4, "", "<U2"), np.zeros(4)
    show(outcome, duration)
    now[0] = 3.0
    show(outcome, duration + 45)
    assert "25 %: 0 of 4 runs, 00:09 left:" in capsys.readouterr().err
