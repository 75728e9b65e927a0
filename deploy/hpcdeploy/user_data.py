"""What a machine of a cloud runs at its first boot: host keys to the console, and the guard."""

from __future__ import annotations

from datetime import datetime

from hpcdeploy.shell import Shell
from hpcdeploy.spec import ClusterSpec

__all__ = ["extend_lease", "user_data"]


def user_data(spec: ClusterSpec, market: str, lease_until: datetime) -> str:
    """Return the script of a machine's first boot; it holds no secret.

    Parameters
    ----------
    spec : ClusterSpec
    market : str
        ``on_demand`` or ``spot``.
    lease_until : datetime
        When the machine ends by itself.
    """
    raise NotImplementedError


def extend_lease(shell: Shell, lease_until: datetime) -> None:
    """Tell the guard of a machine a new end of the lease; where none runs, nothing happens."""
    raise NotImplementedError
