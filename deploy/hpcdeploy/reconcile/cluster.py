"""An opened cluster file: what every verb works on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hpccomponent.errors import CloudError
from hpcdeploy.machine.provider import MachineSeen, Provider, State
from hpcdeploy.reconcile.ownership import require_ours
from hpcdeploy.spec.cluster import ClusterSpec, read_spec
from hpcdeploy.spec.names import HEAD

if TYPE_CHECKING:
    from hpcdeploy.machine.access import Access

__all__ = ["Cluster", "open_cluster"]


@dataclass(frozen=True, slots=True)
class Cluster:
    """A cluster file with the way to its cloud and to its machines.

    Parameters
    ----------
    path : Path
        The file.
    spec : ClusterSpec
    provider : Provider
    access : Access
        Shells on its machines.
    """

    path: Path
    spec: ClusterSpec
    provider: Provider
    access: Access

    def machines(self) -> tuple[MachineSeen, ...]:
        """Return the machines that run, from the cloud: the head first, then by number.

        Raises
        ------
        CloudError
            The cluster was made elsewhere.
        """
        observed = self.provider.observe(self.spec.cluster)
        require_ours(self, observed)
        running = (m for m in observed.machines if m.state is State.RUNNING)
        return tuple(sorted(running, key=node_order))

    def head(self) -> MachineSeen:
        """Return the machine of the HPC App.

        Raises
        ------
        CloudError
            It does not run, or the cluster was made elsewhere.
        """
        for machine in self.machines():
            if machine.name.node == HEAD:
                return machine
        raise CloudError(f"cluster {self.spec.cluster} is not up", f"run hpcapp up {self.path}")


def node_order(machine: MachineSeen) -> tuple[bool, int, str, int]:
    """Order machines as people count them: worker-2 comes before worker-10."""
    node = machine.name.node
    return node != HEAD, len(node), node, machine.name.generation


@contextmanager
def open_cluster(path: Path) -> Iterator[Cluster]:
    """Read a cluster file and open its provider; close the shells at the end.

    Parameters
    ----------
    path : Path

    Raises
    ------
    ConfigError
        The file has mistakes.
    CloudError
        The cloud's keys are not to be found.
    """
    from hpcdeploy.machine.access import make_access  # it imports paramiko, which is slow
    from hpcdeploy.providers import open_provider

    spec = read_spec(path)
    base = path.absolute().parent
    provider = open_provider(spec, base)
    access = make_access(spec, base, provider)
    try:
        yield Cluster(path, spec, provider, access)
    finally:
        access.close()
