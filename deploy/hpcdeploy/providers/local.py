"""No machine but this one: a node is a folder below the cluster's state, with a loader of its own.

The loader is a detached process; it is ended by its recorded process id and time of start, so
that a foreign process is never met.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from hpccomponent.errors import CloudError
from hpcdeploy.install.job_end import end_jobs
from hpcdeploy.install.loader_service import stop_command
from hpcdeploy.install.probe import check_this_python
from hpcdeploy.login.local_shell import LocalShell
from hpcdeploy.provider import (
    Launch,
    MachineSeen,
    Observed,
    Problem,
    State,
)
from hpcdeploy.providers.fixed import CLAIM, Claim, FixedMachines
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.layout import clusters_folder, machine_folder, state_folder
from hpcdeploy.spec.names import NodeName

LOOPBACK = "127.0.0.1"
_NODES = "nodes"


def open_local(spec: ClusterSpec, base: Path) -> LocalProvider:
    """Return the provider of this machine."""
    del base
    return LocalProvider(spec.env.python)


class LocalProvider(FixedMachines):
    """Folders for machines."""

    name = "local"

    def __init__(self, python: str = ">=3.11") -> None:
        self._python = python

    def observe(self, cluster: str | None) -> Observed:
        """Return the nodes whose folders are there."""
        top = clusters_folder()
        folders = [top / cluster] if cluster else sorted(top.glob("*"))
        return Observed(tuple(seen for folder in folders for seen in _nodes(folder)))

    def launch(self, launch: Launch) -> MachineSeen:
        """Make the folder of a node."""
        home = state_folder(launch.cluster) / _NODES / launch.name.node
        claim = home / CLAIM
        if not claim.exists():
            home.mkdir(mode=0o700, parents=True, exist_ok=True)
            beside = claim.with_suffix(".new")
            beside.write_text(Claim.of(launch).to_json())
            beside.replace(claim)
        return _node(claim)

    def terminate(self, machines: Sequence[MachineSeen]) -> None:
        """End the loaders of some nodes, and remove their folders."""
        for machine in machines:
            home = Path(machine.id)
            if not home.exists():
                continue
            shell = LocalShell(machine.name.node, home)
            end_jobs(shell, machine.cluster)
            command = stop_command(machine.cluster, machine_folder(machine.cluster))
            done = shell.run(command)
            if done.exit_code:
                raise CloudError(
                    f"{machine.name.node}: its loader does not end ({done.errors.strip()})",
                    f"see {home} and end it by hand",
                )
            shutil.rmtree(home, ignore_errors=True)

    def check(self) -> list[Problem]:
        """Return what is missing here: an interpreter that will do."""
        try:
            check_this_python(self._python)
        except CloudError as error:
            return [Problem(error.problem, error.advice)]
        return []


def _nodes(folder: Path) -> Iterator[MachineSeen]:
    yield from map(_node, sorted((folder / _NODES).glob(f"*/{CLAIM}")))


def _node(claim: Path) -> MachineSeen:
    machine = MachineSeen(
        id=str(claim.parent),
        cluster=claim.parent.parent.parent.name,
        name=NodeName(claim.parent.name),
        incarnation="",
        state=State.RUNNING,
        public_address=LOOPBACK,
        private_address=LOOPBACK,
    )
    try:
        return Claim.from_json(claim.read_bytes()).mark(machine)
    except (OSError, ValueError) as error:
        raise CloudError(f"{claim}: cannot be read ({error})", "remove its folder") from None
