"""What providers of machines that are there anyway have in common: a claim, and nothing to make."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Annotated

import msgspec
from msgspec import Meta

from hpccomponent.foreign_json import decode
from hpcdeploy.provider import GroupSeen, KeyPairSeen, Launch, MachineSeen
from hpcdeploy.spec.names import NAME_PATTERN, Desired, NodeName, Owner, read_owner

__all__ = ["CLAIM", "Claim", "StandingMachines"]

CLAIM = "machine.json"
"""The file on a machine that says which of a cluster it is."""


@dataclass(frozen=True, slots=True)
class Claim:
    """What lies on a machine while it is one of a cluster; anybody there may have written it.

    Parameters
    ----------
    launched : datetime
        With its time zone.
    owner : str
        See `Owner`.
    """

    cluster: Annotated[str, Meta(pattern=NAME_PATTERN, max_length=40)]
    generation: Annotated[int, Meta(ge=1, le=1 << 30)]
    incarnation: Annotated[str, Meta(pattern=r"^[0-9a-z-]{0,40}\Z")]
    launched: Annotated[datetime, Meta(tz=True)]
    owner: Annotated[str, Meta(max_length=1000)] = ""
    node: Annotated[str, Meta(pattern=r"^(head|worker-[1-9][0-9]{0,5})?\Z")] = ""

    @classmethod
    def of(cls, launch: Launch) -> Claim:
        """Return the claim of a machine that is launched now."""
        name = launch.name
        return cls(launch.cluster, name.generation, launch.incarnation, datetime.now(UTC),
                   str(launch.owner), name.node)  # fmt: skip

    @classmethod
    def from_json(cls, text: str | bytes) -> Claim:
        """Read what `to_json` wrote; ValueError, of one line, where it is no claim."""
        return decode(text, cls)

    def to_json(self) -> str:
        """Return the claim as one line."""
        return json.dumps(msgspec.to_builtins(self))

    def mark(self, machine: MachineSeen) -> MachineSeen:
        """Return a machine as the one that is claimed; it may have had another node's name."""
        return replace(
            machine,
            name=NodeName(self.node or machine.name.node, self.generation),
            incarnation=self.incarnation,
            launched=self.launched,
            owner=read_owner(self.owner),
        )


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

    def set_desired(self, head: MachineSeen, desired: Desired) -> None:
        """Do nothing: no command launches machines that are there."""

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
