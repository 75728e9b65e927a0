"""Nothing outlives its parent: the kernel's signal on Linux, the end of a pipe everywhere."""

from __future__ import annotations

import os
import signal
import sys
import threading

PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int, with_signal: signal.Signals) -> bool:
    """Ask the kernel to send this process `with_signal` when its parent's thread ends.

    `parent` is its process id, as it was before the call: a parent that died before sends nothing
    any more; then this process sends the signal to itself. Return False where the kernel knows no
    such thing; the end of a pipe must serve alone there.
    """
    if not sys.platform.startswith("linux"):
        return False
    import ctypes

    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, int(with_signal), 0, 0, 0) != 0:
        return False
    if os.getppid() != parent:
        os.kill(os.getpid(), with_signal)
    return True


def exit_at_end_of_pipe(descriptor: int, code: int) -> threading.Thread:
    """Start a thread that ends the process at once when the other end of a pipe closes.

    Nothing is ever written to that end.
    """

    def watch() -> None:
        while os.read(descriptor, 1):
            pass
        os._exit(code)

    thread = threading.Thread(target=watch, name="lifeline", daemon=True)
    thread.start()
    return thread
