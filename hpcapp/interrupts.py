"""How the command ends on a signal: the first in order, a second at once.

::

    signal ──C handler──> Python handler, main thread: KeyboardInterrupt unwinds the stack
                 │
                 └──────> pipe ──> thread: counts; the second ends the process

The main thread may be deep in a call that returns to Python late, or never; the thread is not.
What has been started ends by itself then, as after any death of its master.

An import is not interrupted: the import system would keep its locks, and modules make other errors
of what is raised in them, which their importers may expect. A finaliser swallows whatever is raised
in it. In both cases the interruption comes a moment later.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import signal
import sys
import threading
import time
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs


log = logging.getLogger("hpcapp")

EXIT_INTERRUPTED = 130
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
REPEAT_S = 0.3
"""`timeout` and terminals send a signal twice, to the process and to its group: that is one."""
TOLD_AFTER_S = 2.0
AGAIN_S = 0.01
_IMPORT_SYSTEM = "<frozen importlib._bootstrap>"
_is_told = threading.Lock()
_SHOW_CURSOR = b"\x1b[?25h"  # bars hide it


def obey_signals() -> None:
    """Have signals end this process from now on; in the main thread."""
    numbers = {getattr(signal, name) for name in SIGNALS if hasattr(signal, name)}
    handler = _Handler()
    for number in numbers:
        signal.signal(number, handler)
    if not hasattr(signal, "setitimer"):  # Windows, where no pipe can be waited for either
        return
    signal.signal(signal.SIGALRM, handler.unwind)
    sys.unraisablehook = handler.notice
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    thread = threading.Thread(target=_count, args=(reader, numbers), name="signals", daemon=True)
    with contextlib.suppress(RuntimeError):  # no room for a thread: the handler counts alone
        thread.start()


class _Handler:
    """Unwinds the stack on the first signal, and lets nothing disturb that."""

    def __init__(self) -> None:
        self._first: float | None = None
        self._notice = sys.unraisablehook

    def __call__(self, signum: int, frame: FrameType | None) -> None:
        if self._first is None:
            self._first = time.monotonic()
            self.unwind(signum, frame)
        elif time.monotonic() - self._first > REPEAT_S:  # if a library has taken the pipe away
            _end_at_once()

    def unwind(self, signum: int, frame: FrameType | None) -> None:
        """Interrupt what the main thread does, now or a moment later."""
        del signum
        if not hasattr(signal, "setitimer") or not _is_importing(frame):
            raise KeyboardInterrupt
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)

    def notice(self, unraisable: UnraisableHookArgs) -> None:
        """Have an interruption that was swallowed come once more."""
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        else:
            self._notice(unraisable)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None and frame.f_code.co_filename != _IMPORT_SYSTEM:
        frame = frame.f_back
    return frame is not None


def _count(reader: int, numbers: set[int]) -> None:
    """Read the numbers of signals as they come, and end the process with the second."""
    first: float | None = None
    is_told = False
    while True:
        patience_s = TOLD_AFTER_S if first is not None and not is_told else None
        if not select.select([reader], [], [], patience_s)[0]:
            log.warning("ending; a second signal (Ctrl-C) ends at once")
            is_told = True
            continue
        if not numbers.intersection(os.read(reader, 4096)):
            continue
        if first is None:
            first = time.monotonic()
        elif time.monotonic() - first > REPEAT_S:
            _end_at_once()


def _end_at_once() -> None:
    """Say so, once: both the handler and the thread may have counted."""
    if not _is_told.acquire(blocking=False):
        return
    with contextlib.suppress(OSError):
        os.write(2, (_SHOW_CURSOR if os.isatty(2) else b"") + b"hpcapp: interrupted\n")
    os._exit(EXIT_INTERRUPTED)
