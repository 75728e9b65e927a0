"""Commands that stop themselves at a moment: they are there, however late the test comes to act."""

from __future__ import annotations

import os
import signal
import subprocess

from process_tree import descendants

#: What has a command stop once it has written what ``STOP_AFTER`` says to stderr.
SITECUSTOMIZE = """
import os, signal, sys

class Stopping:
    def __init__(self, stream):
        self._stream = stream

    def __getattr__(self, name):
        return getattr(self._stream, name)

    def write(self, text):
        written = self._stream.write(text)
        if os.environ.get("STOP_AFTER", text + "!") in text:
            del os.environ["STOP_AFTER"]
            self._stream.flush()
            os.kill(os.getpid(), signal.SIGSTOP)
        return written

if "hpcapp" in sys.orig_argv:
    sys.stderr = Stopping(sys.stderr)
"""


def read_until(process: subprocess.Popen[str], words: str) -> None:
    """Read what is said until it holds some words."""
    assert process.stderr is not None
    for line in process.stderr:
        if words in line:
            return
    raise AssertionError(f"{words!r} was never said")


def await_stop(process: subprocess.Popen[str], words: str) -> set[int]:
    """Read until the words are said, and the command has stopped; return what it has started."""
    read_until(process, words)
    ended = os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
    assert ended is not None
    assert ended.si_code == os.CLD_STOPPED
    return descendants(process.pid)


def go_on(process: subprocess.Popen[str], signum: signal.Signals) -> None:
    """Let a command that has stopped find a signal as it goes on."""
    process.send_signal(signum)
    process.send_signal(signal.SIGCONT)
