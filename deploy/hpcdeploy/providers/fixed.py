"""What providers of machines that are there anyway have in common: a claim, and nothing to make."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated

import msgspec
from msgspec import Meta

from hpccomponent.dataclass import dataclass
from hpccomponent.foreign_json import decode
from hpcdeploy.provider import (
    Launch,
    MachineSeen,
    Observed,
    Prerequisites,
    Provider,
    Resource,
    Step,
    Tags,
)
from hpcdeploy.spec.names import NAME_PATTERN, NodeName, read_owner

CLAIM = "machine.json"
"""The file on a machine that says which of a cluster it is."""


@dataclass(frozen=True, slots=True)
class Claim:
    """What lies on a machine while it is one of a cluster; anybody there may have written it.

    `owner` is the text of an `Owner`.
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


class FixedMachines(Provider):
    """The part of `Provider` that is about networks, keys, leases and buckets: there are none."""

    makes_machines = False

    def prepare(self, wanted: Prerequisites, observed: Observed) -> list[Step]:
        """Return nothing: the network is as it is, and who may log in is settled."""
        del wanted, observed
        return []

    def tag(
        self, machines: Sequence[MachineSeen], tags: Tags, resources: Sequence[Resource] = ()
    ) -> None:
        """Do nothing: the machines stay, and are the user's own."""

    def cleanup(self, resource: Resource) -> bool:
        """Do nothing: there is none."""
        del resource
        return True

    def console(self, machine: MachineSeen) -> str:
        """Return nothing: a console is its machine's owner's."""
        del machine
        return ""
