"""Machines that are there: hosts of the cluster file, the first of which is the head.

A host is a machine of the cluster when our folder on it holds our claim. To end it is to stop the
loader and to remove that folder; nothing else on a host is touched.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hpccomponent.errors import CloudError
from hpcdeploy.install.installing import write_text
from hpcdeploy.install.job_end import end_jobs
from hpcdeploy.install.loader_service import stop_command
from hpcdeploy.login.access import Access
from hpcdeploy.login.parallel import connections_at_once, run_parallel
from hpcdeploy.login.ssh.reach import LoginFault, ReachError
from hpcdeploy.login.ssh.target import host_address, host_id
from hpcdeploy.provider import (
    Launch,
    MachineSeen,
    Observed,
    Resource,
    State,
    Tags,
)
from hpcdeploy.providers.fixed import CLAIM, Claim, FixedMachines
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.layout import machine_folder
from hpcdeploy.spec.names import HEAD, NodeName, without_node
from hpcdeploy.spec.provider import Host

LOOK_S = 8.0
"""For the login, and again for the one command: so long a look at a host may take."""
UNASKED = (LoginFault.NO_KEY, LoginFault.PASSPHRASE_NEEDED)
"""Why no host was asked at all."""


class SshHosts(FixedMachines):
    """Hosts, and what we have put on them."""

    name = "ssh"

    def __init__(self, spec: ClusterSpec, base: Path) -> None:
        self._spec = spec
        self._access = Access(spec, base, self)
        self._hosts: dict[str, Host] = {
            f"worker-{number}" if number else HEAD: host
            for number, host in enumerate(spec.provider.fixed_hosts)
        }
        self._folder = machine_folder(spec.cluster)

    def observe(self, cluster: str | None) -> Observed:
        """Return the hosts that hold our claim, and those that do not let us see whether they do.

        Raises ReachError where we have no key that can be used: that says nothing of any host.
        """
        if cluster not in (None, self._spec.cluster):
            return Observed()
        looks = run_parallel(self._look, list(self._hosts), connections_at_once(), "hosts")
        unasked = [s for s in looks if isinstance(s, ReachError) and s.reach in UNASKED]
        if len(unasked) == len(looks):
            raise unasked[0]
        seen_by_node = {
            node: self._hidden(node, seen) if isinstance(seen, CloudError) else seen
            for node, seen in zip(self._hosts, looks, strict=True)
            if seen is not None
        }
        return Observed(_without_usurpers(seen_by_node))

    def launch(self, launch: Launch) -> MachineSeen:
        """Claim the host of a node; raise CloudError where it does not answer."""
        machine, claim = self._machine(launch.name.node), Claim.of(launch)
        with self._access.open(machine) as shell:
            write_text(shell, f"{self._folder}/{CLAIM}", claim.to_json())
        return claim.mark(machine)

    def tag(
        self, machines: Sequence[MachineSeen], tags: Tags, resources: Sequence[Resource] = ()
    ) -> None:
        """Write down in the claims whose some hosts are; all else stays with the user."""
        del resources
        for machine in machines if tags.owner is not None else ():
            path = f"{self._folder}/{CLAIM}"
            with self._access.open(machine) as shell:
                claim = self._read_claim(machine, shell.run(f"cat {shlex.quote(path)}").output)
                write_text(shell, path, replace(claim, owner=str(tags.owner)).to_json())

    def terminate(self, machines: Sequence[MachineSeen]) -> None:
        """Stop the loaders and remove our folders; hosts that do not answer stay as they are."""

        def end(machine: MachineSeen) -> CloudError | None:
            try:
                self._end(machine)
            except CloudError as error:  # the others are left clean nevertheless
                return error
            return None

        running = [machine for machine in machines if machine.state is State.RUNNING]
        for error in run_parallel(end, running, connections_at_once(), "hosts"):
            if error is not None:
                raise error

    def hosts(self) -> tuple[MachineSeen, ...]:
        """Return the file's hosts, whether they answer or not."""
        return tuple(self._machine(node) for node in self._hosts)

    def _machine(self, node: str) -> MachineSeen:
        host = self._hosts[node]
        address = host_address(host)
        return MachineSeen(
            id=host_id(host),
            cluster=self._spec.cluster,
            name=NodeName(node),
            incarnation="",
            state=State.RUNNING,
            public_address=address,
            private_address=host.private_address or address,
        )

    def _hidden(self, node: str, error: CloudError) -> MachineSeen:
        """Return a host of which nothing is known but why."""
        reason = without_node(str(error), node)
        if isinstance(error, ReachError):
            reason = f"{error.reach}: {reason.removeprefix(f'{error.reach}: ')}"
        return replace(self._machine(node), state=State.UNKNOWN, reason=reason)

    def _look(self, node: str) -> MachineSeen | CloudError | None:
        machine = self._machine(node)
        try:
            with self._access.open(machine, LOOK_S) as shell:
                done = shell.run(f"cat {shlex.quote(self._folder)}/{CLAIM}", timeout_s=LOOK_S)
            return None if done.exit_code else self._read_claim(machine, done.output).mark(machine)
        except CloudError as error:  # the others are served nevertheless
            return error

    def _read_claim(self, machine: MachineSeen, text: str) -> Claim:
        try:
            return Claim.from_json(text)
        except ValueError as error:
            raise CloudError(
                f"{machine.name.node} ({machine.id}): {self._folder}/{CLAIM} cannot be read "
                f"({error})",
                f"remove ~/{self._folder} there",
            ) from None

    def _end(self, machine: MachineSeen) -> None:
        stop = stop_command(self._spec.cluster, self._folder)
        remove = f"rm -rf {shlex.quote(self._folder)} && {{ rmdir hpcapp 2>/dev/null; true; }}"
        with self._access.open(machine) as shell:
            end_jobs(shell, self._spec.cluster)
            done = shell.run(f"{stop}cd && {remove}", timeout_s=60.0)
        if done.exit_code:
            raise CloudError(
                f"{machine.name.node} ({machine.id}): what we put there cannot be removed: "
                f"{done.reason}",
                f"remove ~/{self._folder} there by hand",
            )


def _without_usurpers(seen_by_node: Mapping[str, MachineSeen]) -> tuple[MachineSeen, ...]:
    """Return the hosts, none by the name of another that the file names so and that bears it.

    After a change of the file a host may well claim to be another node. But whoever claims to be
    the head beside the head would have it ended, and be given its keys.
    """
    borne = {node for node, seen in seen_by_node.items() if seen.name.node == node}
    return tuple(
        replace(seen, name=NodeName(node, seen.name.generation))
        if seen.name.node in borne - {node}
        else seen
        for node, seen in seen_by_node.items()
    )
