import re

import numpy as np

from jaxreplay.cli.progress import Progress


def test_progress_is_shown_in_lines_where_there_is_no_terminal(capsys):
    """Every tenth of the runs: what came of them, how fast it goes, and how long it will."""
    show, outcome, duration = Progress(20), np.full(20, "", "<U2"), np.zeros(20)
    outcome[:6], duration[:6] = "S", 100  # from an earlier call
    show(outcome, duration)
    assert capsys.readouterr().err == ""
    outcome[6:9], duration[6:10] = ["S", "Fs", "Fb"], 50
    show(outcome, duration)
    (line,) = capsys.readouterr().err.splitlines()
    assert re.fullmatch(
        r"9 of 20 runs: S 7, Fs 1, Fg 0, Fb 1; \d+ simulated s a second, \d+ s left", line
    )
    show(outcome, duration)
    assert capsys.readouterr().err == ""
