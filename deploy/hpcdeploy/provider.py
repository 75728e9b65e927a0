"""The interface of every kind of cloud, and what it speaks about.

Providers hold no state of their own: `observe` tells what exists, and every other call may be
repeated after a crash without harm, because what it makes is known by its name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import ClassVar, NamedTuple, Protocol

from hpccomponent.dataclass import dataclass
from hpcdeploy.spec.job_folder import JobOrder, JobStatus
from hpcdeploy.spec.names import HEAD, NOBODY, Desired, NodeName, Owner


class State(StrEnum):
    """Where the life of a machine stands."""

    PENDING = "pending"
    RUNNING = "running"
    STOPPED = "stopped"  # costs its disk; a machine that shut itself down on a Eucalyptus
    ENDING = "ending"
    GONE = "gone"
    UNKNOWN = "unknown"  # it is there, but does not let us see what it does: it may be at work


class LaunchChoice(NamedTuple):
    """One way to have a machine; `market` is ``on_demand`` or ``spot``.

    `place` is a zone, or the id of a subnet, where the file names several; else empty.
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
    set_up_by : str
        Who has begun to set it up without having launched it: user and host; empty where nobody.
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
    set_up_by: str = ""

    def address(self, kind: str = "auto") -> str:
        """Return where the machine is reached; empty while it is nowhere.

        `kind` is ``public``, ``private``, or ``auto``: the public address where there is one.
        """
        known = {"public": (self.public_address,), "private": (self.private_address,)}
        return next(filter(None, known.get(kind, (self.public_address, self.private_address))), "")


@dataclass(frozen=True, slots=True)
class Resource:
    """What a cloud keeps for a cluster beside its machines: a network, a key.

    Parameters
    ----------
    incarnation : str
        Of the cluster's life that it was made in.
    id : str
        Empty where its name is its id.
    owner : Owner
        As its tag says; empty where it has none.
    fingerprint : str
        Of a key, in the cloud's own form.

    Attributes
    ----------
    kind : str
        What users call it: ``security group``.
    bears_life : bool
        Whether a life of the cluster begins with it. Making it is then the one step that a cloud
        lets only one of two hurried users take, so that both go on with the same incarnation.
    """

    cluster: str
    name: str
    incarnation: str = ""
    id: str = ""
    owner: Owner = NOBODY
    fingerprint: str = ""

    kind: ClassVar[str] = "resource"
    bears_life: ClassVar[bool] = False


@dataclass(frozen=True, slots=True)
class Observed:
    """All that exists, of one cluster or of every one; gone machines may still be listed."""

    machines: tuple[MachineSeen, ...] = ()
    resources: tuple[Resource, ...] = ()

    @property
    def lives(self) -> tuple[Resource, ...]:
        """The resources by which the lives of clusters are known."""
        return tuple(resource for resource in self.resources if resource.bears_life)

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
    instance_type, market, place : str
        The type is one of the profile's; the others are as in `LaunchChoice`.
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
    """Something that `check` found; `up` would fail over what is fatal.

    `excerpt` is lines of somebody else's that tell more, such as the end of a machine's console.
    """

    what: str
    advice: str
    is_fatal: bool = True
    excerpt: str = ""


@dataclass(frozen=True, slots=True)
class Prerequisites:
    """What a cluster needs before its machines are launched.

    `incarnation` is of the cluster's life that is there, or is to begin. Networks (CIDR) in
    `ssh_from` may reach the SSH port, and machines the `internal_ports` of one another.
    """

    cluster: str
    incarnation: str
    ssh_from: frozenset[str] = frozenset()
    internal_ports: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the preparation.

    Parameters
    ----------
    kind : str
        As programs read it: ``CreateKeyPair``.
    what : str
        As users read it, in the infinitive: "create the key pair".
    carry_out : callable
        Takes who is to own what is made, and returns the cluster's life by then: another one than
        `begins` where somebody else was first. It may be repeated.
    begins : str
        The life of the cluster that begins with it; empty where none does.
    makes : bool
        Whether it makes what is to be taken away in the end.
    """

    kind: str
    what: str
    carry_out: Callable[[Principal], str] = field(repr=False, compare=False)
    begins: str = ""
    makes: bool = False

    def __str__(self) -> str:
        return self.what


class Principal(Protocol):
    """Who carries out a preparation: an owner with a key."""

    def owner(self) -> Owner:
        """Return who is to own what is made."""
        ...

    def public_key(self) -> str:
        """Return the key that machines are to let in, in OpenSSH's form."""
        ...


@dataclass(frozen=True, slots=True)
class Tags:
    """What a cloud keeps with machines and lists again; None leaves it as it is.

    `desired` is how many workers the cluster is to have: its head bears it.
    """

    owner: Owner | None = None
    desired: Desired | None = None
    lease_until: datetime | None = None
    set_up_by: str | None = None


class Bucket(Protocol):
    """A place for large files between the user's machine and the head."""

    def send(
        self,
        points: Path,
        digest: str,
        order: JobOrder,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> JobOrder:
        """Send a job's points unless they are there; return the order with its addresses.

        Parameters
        ----------
        digest : str
            Its SHA-256, which is part of the object's name.
        on_progress : callable, optional
            Told (bytes sent, bytes in all).
        """
        ...

    def fetch(self, status: JobStatus, target: Path) -> None:
        """Fetch a job's mesh, check it, and take it out of the bucket."""
        ...

    def clear(self) -> None:
        """Take away all that the cluster's jobs have put there, and uploads that were cut short."""
        ...


class Provider(Protocol):
    """A kind of cloud: seven calls, and answers that have a default.

    Every method raises `CloudError` with one line that says what the cloud refused, why and what
    to do; `CapacityError` where another instance type, market or zone may still be had.
    """

    name: str
    makes_machines: bool
    """Whether machines are made and paid for, or are there anyway."""

    def observe(self, cluster: str | None) -> Observed:
        """Return all that exists of a cluster of ours, or of every one where None."""
        ...

    def prepare(self, wanted: Prerequisites, observed: Observed) -> Sequence[Step]:
        """Return what must still be done before machines are launched; nothing is changed.

        Parameters
        ----------
        observed : Observed
            What other clusters have does not matter.
        """
        ...

    def launch(self, launch: Launch) -> MachineSeen:
        """Start a machine; asked again with the same names, return the one that was started."""
        ...

    def tag(
        self, machines: Sequence[MachineSeen], tags: Tags, resources: Sequence[Resource] = ()
    ) -> None:
        """Write down what machines, and resources that can, are to bear from now on."""
        ...

    def terminate(self, machines: Sequence[MachineSeen]) -> None:
        """Begin to end some machines; those that have ended do not matter."""
        ...

    def cleanup(self, resource: Resource) -> bool:
        """Delete a resource; False while it is in use. One that is gone does not matter."""
        ...

    def console(self, machine: MachineSeen) -> str:
        """Return what a machine has printed on its console so far; empty where it has none."""
        ...

    def hosts(self) -> tuple[MachineSeen, ...]:
        """Return the machines that are there before they belong to a cluster."""
        return ()

    def decided(self) -> tuple[str, ...]:
        """Say what the file leaves open and is decided for this command, in a line each."""
        return ()

    def check(self) -> list[Problem]:
        """Look, without changing anything, for what would make `up` fail."""
        return []

    def bucket(self) -> Bucket | None:
        """Return the bucket that the cluster file names; None where it names none."""
        return None
