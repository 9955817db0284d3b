"""A command that is interrupted or terminated ends at once, with one line and no process left."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
from study_helpers import made_up_study, write

NOTE = "; finished shards are kept; run the same command again to continue"


def of_session(number):
    """The processes of a session that have not ended."""
    found = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == number and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except (ProcessLookupError, psutil.NoSuchProcess):
            pass
    return found


def stopped(folder, after, number, *more):
    """Start a study in a session of its own and stop it: status, stderr, and what is left."""
    config = write(folder, "[axis]\ntheta_i = {logspace = [-1, -6, 20]}")
    command = [sys.executable, "-m", "jaxreplay", "run", config, "--out", folder / "out", *more]
    process = subprocess.Popen(
        list(map(str, command)), stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    time.sleep(after)
    assert process.poll() is None, process.communicate()
    began = time.monotonic()
    # Ctrl-C on a terminal reaches all processes of a command, SIGTERM the one that it is sent to.
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    _, told = process.communicate(timeout=30)
    while of_session(process.pid) and time.monotonic() < began + 3:
        time.sleep(0.05)
    return process.returncode, time.monotonic() - began, told, of_session(process.pid)


@pytest.mark.parametrize(
    ("after", "number", "more"),
    [
        (1.5, signal.SIGINT, []),
        (9.0, signal.SIGINT, ["--workers", "2"]),
        (4.0, signal.SIGTERM, []),
        *(
            pytest.param(0.5 * k, signal.SIGINT, more, marks=pytest.mark.slow)
            for more in ([], ["--workers", "2"])
            for k in range(1, 36)
        ),
        *(
            pytest.param(1.0 + 2 * k, signal.SIGTERM, ["--workers", "2"], marks=pytest.mark.slow)
            for k in range(8)
        ),
    ],
)
def test_a_stopped_study_ends_at_once_with_one_line(tmp_path, after, number, more):
    status, seconds, told, left = stopped(tmp_path, after, number, *more)
    assert status == 128 + number
    assert seconds < 3
    assert not left
    *before, last = told.splitlines()
    word = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}[number]
    assert last in (f"jaxreplay: {word}", f"jaxreplay: {word}{NOTE}")
    # Before it stand at most the number of runs and the progress.
    assert all(" runs in " in line or "simulated" in line for line in before)


def test_signals_that_were_ignored_still_are(tmp_path):
    """As `nohup` or the background of a script start a command."""
    code = (
        "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN);"
        "from jaxreplay.cli.stop import stop_on_signals; stop_on_signals();"
        "os.kill(os.getpid(), signal.SIGINT); print('goes on')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "goes on\n")


@pytest.mark.parametrize(
    "closed", [">&- 2>&-", *(pytest.param(c, marks=pytest.mark.slow) for c in ("2>&-", "<&-"))]
)
def test_a_closed_stream_is_no_failure(tmp_path, closed):
    """As where a job's output is not wanted."""
    made_up_study(write(tmp_path, "theta_i = 0.1"), tmp_path / "out")
    command = f"{sys.executable} -m jaxreplay show out {closed}"
    done = subprocess.run(command, shell=True, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    assert done.returncode == 0
    assert "error of S, mm" in done.stdout or ">&- 2" in closed
