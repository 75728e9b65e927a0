"""The worker process as its component sees it: started by exec, ended without mercy."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence

from hpccomponent.runtime.channel import Channel

# One task is one thread of work; numpy reads these once, when it is imported.
THREAD_VARIABLES = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA", "VECLIB_MAXIMUM")

# What a task frees is not given back: read by glibc when the process starts.
KEPT_MEMORY = {"MALLOC_MMAP_MAX_": "0", "MALLOC_TRIM_THRESHOLD_": str(2**31 - 1)}


class WorkerProcess:
    """A running worker process, the channel to it, and the pipe whose end it dies of.

    `tasks` are ``NAME=module:function`` of those that are no entry points; kernels find the worker
    build in the variable ``HPCAPP_BUILD``.
    """

    def __init__(self, tasks: Sequence[str] = (), build: str = "") -> None:
        ours, theirs = socket.socketpair()
        reading, self._lifeline = os.pipe()
        command = [sys.executable, "-P", "-m", "hpccomponent.runtime.worker"]
        command += ["--channel-fd", str(theirs.fileno()), "--lifeline-fd", str(reading)]
        command += ["--parent", str(os.getpid())]
        for task in tasks:
            command += ["--task", task]
        try:
            self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                command,
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(), reading),
                env=_environment(build),
            )
        except BaseException:
            os.close(self._lifeline)
            ours.close()
            raise
        finally:
            theirs.close()
            os.close(reading)
        self.channel = Channel(ours)

    @property
    def pid(self) -> int:
        """Return the process id."""
        return self._process.pid

    def end(self) -> str:
        """Kill the process if it still runs, free what belongs to it, and say how it ended."""
        self.channel.close()
        os.close(self._lifeline)
        had_ended = self._process.poll() is not None
        try:
            # The channel ends a little before the process: its own exit code says more than ours.
            code = self._process.wait(timeout=0.2)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        if code >= 0:
            return f"the worker process left with exit code {code}"
        name = signal.Signals(-code).name
        hint = " (out of memory?)" if name == "SIGKILL" and had_ended else ""
        return f"the worker process was ended by {name}{hint}"


def _environment(build: str) -> dict[str, str]:
    """Return the worker's variables: one thread, and the build that was announced for it.

    Memory that a task has freed is for the next one, which takes as much.
    """
    threads = {f"{name}_NUM_THREADS": "1" for name in THREAD_VARIABLES}
    return os.environ | threads | KEPT_MEMORY | ({"HPCAPP_BUILD": build} if build else {})
