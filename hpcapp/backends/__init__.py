"""Where tasks run: every backend is an Executor."""

from __future__ import annotations

__all__ = ["BACKENDS"]

BACKENDS = ("serial", "threads", "processes", "zmq")
"""Those of this machine; others are named by what they reach, see `selection`."""
