"""Real `hpcapp` processes that a test kills with SIGKILL at a step of its choice.

::

    test ──"run up ..."──> zygote (imports once) ──fork──> hpcapp up ...
      │                                                      │ set-up steps, by a socket
      └── SIGKILL at the n-th step <──hooks of the cloud─────┘ API calls, by HTTP

A step is an API call before or after the cloud carries it out, or a step of a machine's set-up.
"""

from __future__ import annotations

import json
import os
import signal
import socketserver
import subprocess
import sys
import threading
from pathlib import Path
from typing import Self

from cloud import Call, CutError

__all__ = ["Killer"]

ZYGOTE = Path(__file__).with_name("zygote.py")


class Killer:
    """Runs commands, counts their steps, and kills one at a step."""

    def __init__(self) -> None:
        self.environment: dict[str, str] = {}
        self.steps: list[str] = []
        self._kill_at: int | None = None
        self._pid: int | None = None
        self._lock = threading.Lock()
        self._server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), self._handler())
        self._server.daemon_threads = False
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()
        self._zygote = subprocess.Popen(
            [sys.executable, str(ZYGOTE), str(self._server.server_address[1])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, *arguments: str, kill_at: int | None = None) -> tuple[int, str]:
        """Run ``hpcapp ARGUMENTS``; return its exit code (-9: it was killed) and its stderr."""
        assert self._zygote.stdin is not None
        assert self._zygote.stdout is not None
        with self._lock:
            self.steps, self._kill_at, self._pid = [], kill_at, None
        self._zygote.stdin.write(json.dumps([arguments, self.environment]) + "\n")
        self._zygote.stdin.flush()
        code, said = json.loads(self._zygote.stdout.readline())
        with self._lock:
            self._pid = None
        return code, said

    def take_step(self, step: str) -> None:
        """Count a step; kill the command if it is the one."""
        with self._lock:
            self.steps.append(step)
            if len(self.steps) == self._kill_at and self._pid is not None:
                os.kill(self._pid, signal.SIGKILL)
                raise CutError(step)

    def on_call(self, call: Call, moment: str) -> None:
        """Take a step at an API call: the hook of a `StrictCloud`."""
        self.take_step(f"{moment} {call.action}")

    def _handler(self) -> type[socketserver.StreamRequestHandler]:
        killer = self

        class Handler(socketserver.StreamRequestHandler):
            """A line for each step; the answer lets the command go on."""

            def handle(self) -> None:
                for line in self.rfile:
                    word, _, text = line.decode().strip().partition(" ")
                    if word == "pid":
                        killer._pid = int(text)
                    else:
                        try:
                            killer.take_step(text)
                        except CutError:
                            return
                    try:
                        self.wfile.write(b"go\n")
                    except OSError:  # it was killed by another step
                        return

        return Handler

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with self._zygote:
            assert self._zygote.stdin is not None
            self._zygote.stdin.close()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
