"""What providers of machines that are there anyway have in common: nothing to make."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from hpcdeploy.machine.provider import GroupSeen, KeyPairSeen, MachineSeen
from hpcdeploy.spec.names import Owner

__all__ = ["StandingMachines"]


class StandingMachines:
    """The part of `Provider` that is about networks, keys and leases: there are none to manage."""

    makes_machines = False

    def create_key_pair(self, cluster: str, incarnation: str, public_key: str) -> KeyPairSeen:
        """Do nothing: who may log in is settled."""
        del public_key
        return KeyPairSeen(cluster, "", incarnation)

    def create_group(self, cluster: str, incarnation: str, owner: Owner) -> GroupSeen:
        """Do nothing: the network is as it is."""
        del owner
        return GroupSeen(cluster, "", "", incarnation)

    def allow(
        self, group: GroupSeen, ssh_from: frozenset[str], internal_ports: frozenset[int]
    ) -> None:
        """Do nothing: the network is as it is."""

    def mark(
        self, machines: Sequence[MachineSeen], groups: Sequence[GroupSeen], owner: Owner
    ) -> None:
        """Do nothing: on this machine all is the user's own."""

    def extend(self, machines: Sequence[MachineSeen], lease_until: datetime) -> None:
        """Do nothing: the machines stay."""

    def decided(self) -> tuple[str, ...]:
        """Return nothing: the file says all."""
        return ()

    def delete_group(self, group: GroupSeen) -> bool:
        """Do nothing: there is none."""
        del group
        return True

    def delete_key_pair(self, key_pair: KeyPairSeen) -> None:
        """Do nothing: there is none."""

    def console(self, machine: MachineSeen) -> str:
        """Return nothing: a console is its machine's owner's."""
        del machine
        return ""
