"""The interface of every kind of cloud, and what it speaks about.

Providers hold no state of their own: `observe` tells what exists, and every other call may be
repeated after a crash without harm, because what it makes is known by its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import NamedTuple, Protocol

from hpcdeploy.spec.names import HEAD, NOBODY, Desired, NodeName, Owner

__all__ = [
    "GroupSeen",
    "KeyPairSeen",
    "Launch",
    "LaunchChoice",
    "MachineSeen",
    "Observed",
    "Problem",
    "Provider",
    "State",
]


class State(StrEnum):
    """Where the life of a machine stands."""

    PENDING = "pending"
    RUNNING = "running"
    STOPPED = "stopped"  # costs its disk; a machine that shut itself down on a Eucalyptus
    ENDING = "ending"
    GONE = "gone"
    UNKNOWN = "unknown"  # it is there, but does not let us see what it does: it may be at work


class LaunchChoice(NamedTuple):
    """One way to have a machine.

    Parameters
    ----------
    market : str
        ``on_demand`` or ``spot``.
    place : str
        A zone, or the id of a subnet, where the file names several; else empty.
    """

    instance_type: str
    market: str
    place: str = ""

    def __str__(self) -> str:
        where = f", {self.place}" if self.place else ""
        return f"{self.instance_type} ({self.market}{where})"


@dataclass(frozen=True, slots=True)
class MachineSeen:
    """A machine as the cloud describes it.

    Parameters
    ----------
    incarnation : str
        Of the cluster's life that it was launched in.
    public_address, private_address : str
        Empty while there is none.
    instance_type, market, zone : str
        `market` is ``on_demand`` or ``spot``.
    reason : str
        Why it is in its state, where the cloud says so.
    owner : Owner
        As its tag says; empty where it has none.
    desired : Desired, optional
        How many workers its cluster is to have, as the tag of a head says.
    image, subnet : str
        Their ids; empty where the cloud lists none.
    made_as : str
        By what it was launched, as its tag says; see `drift.made_as`.
    """

    id: str
    cluster: str
    name: NodeName
    incarnation: str
    state: State
    public_address: str = ""
    private_address: str = ""
    instance_type: str = ""
    market: str = "on_demand"
    zone: str = ""
    launched: datetime | None = None
    lease_until: datetime | None = None
    reason: str = ""
    owner: Owner = NOBODY
    desired: Desired | None = None
    image: str = ""
    subnet: str = ""
    made_as: str = ""

    def address(self, kind: str = "auto") -> str:
        """Return where the machine is reached; empty while it is nowhere.

        Parameters
        ----------
        kind : str
            ``public``, ``private``, or ``auto``: the public address where there is one.
        """
        known = {"public": (self.public_address,), "private": (self.private_address,)}
        return next(filter(None, known.get(kind, (self.public_address, self.private_address))), "")


@dataclass(frozen=True, slots=True)
class KeyPairSeen:
    """A key pair of ours.

    Parameters
    ----------
    incarnation : str
        Of the cluster's life that it was made in.
    fingerprint : str
        Of the key, in the cloud's own form.
    """

    cluster: str
    name: str
    incarnation: str = ""
    fingerprint: str = ""


@dataclass(frozen=True, slots=True)
class GroupSeen:
    """A security group of ours.

    Parameters
    ----------
    incarnation : str
        Of the cluster: drawn when the group was made and written into its description. Making a
        group is the one step that a cloud lets only one of two hurried users take, so that both
        go on with the same incarnation.
    ssh_from : frozenset of str
        Networks (CIDR) that reach the SSH port.
    internal_ports : frozenset of int
        Ports that machines of the group reach on one another.
    owner : Owner
        As its tag says; empty where it has none.
    """

    cluster: str
    id: str
    name: str
    incarnation: str = ""
    ssh_from: frozenset[str] = frozenset()
    internal_ports: frozenset[int] = frozenset()
    owner: Owner = NOBODY


@dataclass(frozen=True, slots=True)
class Observed:
    """All that exists, of one cluster or of every one.

    Parameters
    ----------
    machines : tuple of MachineSeen
        Those that are gone may still be listed.
    """

    machines: tuple[MachineSeen, ...] = ()
    key_pairs: tuple[KeyPairSeen, ...] = ()
    groups: tuple[GroupSeen, ...] = ()

    def desired(self, cluster: str) -> Desired | None:
        """Return how many workers a cluster is to have; None where no head that lives says so."""
        heads = (m for m in self.machines if (m.cluster, m.name.node) == (cluster, HEAD))
        live = (m for m in heads if m.state in (State.PENDING, State.RUNNING))
        return max((m.desired for m in live if m.desired is not None), default=None)


@dataclass(frozen=True, slots=True)
class Launch:
    """A machine that is wanted.

    Parameters
    ----------
    profile : str
        A name in the file's ``profiles``; empty where the provider has none.
    instance_type : str
        One of the profile's.
    market : str
        ``on_demand`` or ``spot``.
    place : str
        A zone or the id of a subnet, where the file names several.
    user_data : str
        What the machine runs at its first boot.
    desired : Desired, optional
        How many workers the cluster is to have, for its head.
    made_as : str
        What the file says of the machine that its cloud does not list; written on it.
    """

    cluster: str
    incarnation: str
    name: NodeName
    profile: str = ""
    instance_type: str = ""
    market: str = "on_demand"
    place: str = ""
    user_data: str = field(default="", repr=False)
    lease_until: datetime | None = None
    tags: dict[str, str] = field(default_factory=dict)
    owner: Owner = NOBODY
    desired: Desired | None = None
    made_as: str = ""


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that `check` found.

    Parameters
    ----------
    is_fatal : bool
        Whether `up` would fail over it.
    excerpt : str
        Lines of somebody else's that tell more, such as the end of a machine's console.
    """

    what: str
    advice: str
    is_fatal: bool = True
    excerpt: str = ""


class Provider(Protocol):
    """A kind of cloud.

    Every method raises `CloudError` with one line that says what the cloud refused, why and what
    to do; `CapacityError` where another instance type, market or zone may still be had.
    """

    name: str
    makes_machines: bool
    """Whether machines are made and paid for, or are there anyway."""

    def observe(self, cluster: str | None) -> Observed:
        """Return all that exists of a cluster of ours, or of every one where None."""
        ...

    def hosts(self) -> tuple[MachineSeen, ...]:
        """Return the machines that are there before they belong to a cluster."""
        ...

    def decided(self) -> tuple[str, ...]:
        """Say what the file leaves open and is decided for this command, in a line each."""
        ...

    def create_key_pair(self, cluster: str, incarnation: str, public_key: str) -> KeyPairSeen:
        """Make the key pair of a cluster's life known, or return the one there is."""
        ...

    def create_group(self, cluster: str, incarnation: str, owner: Owner) -> GroupSeen:
        """Make the security group of a cluster, without rules; or return the one there is.

        Parameters
        ----------
        incarnation : str
            Written into the description of a new group.
        """
        ...

    def mark(
        self, machines: Sequence[MachineSeen], groups: Sequence[GroupSeen], owner: Owner
    ) -> None:
        """Write down whose some machines and groups are from now on."""
        ...

    def set_desired(self, head: MachineSeen, desired: Desired) -> None:
        """Write on the head how many workers the cluster is to have from now on."""
        ...

    def allow(
        self, group: GroupSeen, ssh_from: frozenset[str], internal_ports: frozenset[int]
    ) -> None:
        """Make these the rules of a group: add what is missing, revoke what is too much.

        Parameters
        ----------
        ssh_from : frozenset of str
            Networks (CIDR) that may reach the SSH port.
        internal_ports : frozenset of int
            Ports that machines of the group may reach on one another.
        """
        ...

    def launch(self, launch: Launch) -> MachineSeen:
        """Start a machine; asked again with the same names, return the one that was started."""
        ...

    def extend(self, machines: Sequence[MachineSeen], lease_until: datetime) -> None:
        """Write a new end of the lease on some machines."""
        ...

    def terminate(self, machines: Sequence[MachineSeen]) -> None:
        """Begin to end some machines; those that have ended do not matter."""
        ...

    def delete_group(self, group: GroupSeen) -> bool:
        """Delete a group; False while it is in use."""
        ...

    def delete_key_pair(self, key_pair: KeyPairSeen) -> None:
        """Delete a key pair; one that is gone does not matter."""
        ...

    def console(self, machine: MachineSeen) -> str:
        """Return what a machine has printed on its console so far.

        Returns
        -------
        str
            Empty where there is nothing, or no console.
        """
        ...

    def check(self) -> list[Problem]:
        """Look, without changing anything, for what would make `up` fail."""
        ...
