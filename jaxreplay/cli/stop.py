"""Ends the process when it is interrupted or terminated, whatever it is doing.

Python calls a signal's handler between two instructions of the main thread. That may be compiling
for ten seconds, or be in a callback that swallows exceptions; and a process that is starting has
no `except` around it yet. So a thread of its own waits for signals. Nothing needs to be cleaned up:
files are written completely or not at all.
"""

import os
import signal
import socket
import sys
from contextlib import suppress
from threading import Thread

import psutil

_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
_note = ""  # what else to say


def stop_on_signals() -> None:
    """From now on, end the process on SIGINT (status 130) and SIGTERM (143), with one line.

    Its children end, too. Signals that were ignored when the process started, as in the background
    of a script, still are.
    """
    ours, theirs = socket.socketpair()
    theirs.setblocking(False)
    for number in _WORDS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
    Thread(target=_wait, args=(ours, theirs), daemon=True).start()
    leave_sigint_to_that_thread()


def leave_sigint_to_that_thread() -> None:
    """Block SIGINT in this thread, and in the threads and processes that it will start.

    So of all processes that Ctrl-C on a terminal reaches only the first answers.
    """
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def note_on_stop(text: str) -> None:
    """Set what is printed, beside that the process was stopped."""
    global _note
    _note = f"; {text}"


def _wait(ours: socket.socket, theirs: socket.socket) -> None:
    """Wait for a signal, and end the process. `theirs` is kept open by being an argument."""
    while (number := ours.recv(1)[0]) not in _WORDS:  # a signal that something else handles
        pass
    bar = "\n" if sys.stderr is not None and sys.stderr.isatty() else ""  # ends a progress bar
    with suppress(OSError):  # stderr is closed
        os.write(2, f"{bar}jaxreplay: {_WORDS[signal.Signals(number)]}{_note}\n".encode())
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # for what other threads will say
    children = psutil.Process().children(recursive=True)
    for child in children:
        with suppress(psutil.NoSuchProcess):
            child.kill()
    psutil.wait_procs(children, timeout=1)
    os._exit(128 + number)
