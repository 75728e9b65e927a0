"""Where tasks run: every backend is an Executor."""

from __future__ import annotations

__all__ = ["BACKENDS", "IN_PROCESS"]

BACKENDS = ("serial", "threads", "processes", "zmq")
"""Those of this machine; others are named by what they reach, see `selection`."""

IN_PROCESS = ("serial", "threads")
"""Those whose tasks run in the process that submits them."""
