"""The way to the machines of a cluster: its SSH key, its pinned host keys, and shells."""

from __future__ import annotations

import threading
from pathlib import Path

from hpcdeploy.local_shell import LocalShell
from hpcdeploy.provider import MachineSeen, Provider
from hpcdeploy.shell import Shell
from hpcdeploy.spec import ClusterSpec

__all__ = ["Access", "make_access"]

BOOT_S = 300.0  # until a machine answers; the slowest image that we have seen took 120 s


class Access:
    """Opens shells on the machines of one cluster; safe to use from several threads.

    Parameters
    ----------
    spec : ClusterSpec
    base : Path
        The folder of the cluster file, which its paths are relative to.
    provider : Provider
        Whose console shows the host keys.
    """

    def __init__(self, spec: ClusterSpec, base: Path, provider: Provider) -> None:
        self._spec = spec
        self._base = base
        self._provider = provider
        self._closing = threading.Event()

    def public_key(self) -> str:
        """Return the public half of the cluster's SSH key, in OpenSSH's form; made on first use."""
        raise NotImplementedError

    def open(self, machine: MachineSeen, timeout_s: float = BOOT_S) -> Shell:
        """Open a shell on a machine, and wait until it answers.

        Raises
        ------
        CloudError
            It did not answer in time, or its host key is not the pinned one.
        """
        if self._spec.provider.type == "local":
            return LocalShell(machine.name.node, Path(machine.id))
        raise NotImplementedError(timeout_s)

    def close(self) -> None:
        """Close every shell that is still open."""
        self._closing.set()


def make_access(spec: ClusterSpec, base: Path, provider: Provider) -> Access:
    """Return the way to the machines of a cluster."""
    return Access(spec, base, provider)
