"""The user's side: the command, the communicator and the master processes of applications.

From Python: ``with hpcapp.open_executor("cluster.yaml") as backend: backend.executor.submit(...)``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcapp.backends import open_executor

__all__ = ["open_executor"]


def __getattr__(name: str) -> Any:
    """Import the backends when they are used: ``import hpcapp`` must stay light."""
    if name != "open_executor":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from hpcapp.backends import open_executor

    return open_executor
