"""A cloud in memory, the double of one that speaks EC2: what tests of `up` and `down` run against.

It has the habits of real ones that matter: machines are pending for a while and ending for a
while, a fresh machine may be missing from the lists at first, a token is remembered after its
machine is gone, a group in use cannot be deleted, capacity runs out.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any, Literal

from hpccomponent.errors import CapacityError, CloudError
from hpcdeploy.provider import (
    Bucket,
    Launch,
    MachineSeen,
    Observed,
    Prerequisites,
    Provider,
    Resource,
    State,
    Step,
    Tags,
)
from hpcdeploy.providers.ec2.access import plan_access
from hpcdeploy.providers.ec2.names import client_token, group_name, key_pair_name
from hpcdeploy.providers.ec2.observe import GroupSeen, KeyPairSeen
from hpcdeploy.spec.names import Owner
from hpcdeploy.spec.polling import utc_now

Hook = Callable[[Literal["before", "after"], str], None]


@dataclass(slots=True)
class _Machine:
    seen: MachineSeen
    launched: datetime
    ended: datetime | None = None


class MemoryProvider(Provider):
    """A cloud in memory.

    Parameters
    ----------
    now : callable
        Gives the time in UTC.
    boot_s, end_s : float
        How long a machine is pending, and how long it is ending.
    unseen_s : float
        How long a fresh machine is missing from `observe`.
    listed_s : float
        How long a machine that is gone is still listed.
    hook : callable, optional
        Called with ``before`` or ``after`` and the name of every call; what it raises is what the
        caller gets. Raised ``after``, the work is done and its answer lost.

    Attributes
    ----------
    unavailable : set of (str, str)
        Instance types and markets that are not to be had.
    never_boot : set of str
        Nodes whose machines stay pending.
    """

    name = "memory"
    makes_machines = True

    def __init__(
        self,
        now: Callable[[], datetime] = utc_now,
        boot_s: float = 0.0,
        end_s: float = 0.0,
        unseen_s: float = 0.0,
        listed_s: float = 3600.0,
        hook: Hook | None = None,
    ) -> None:
        self._now = now
        self._boot, self._end = timedelta(seconds=boot_s), timedelta(seconds=end_s)
        self._unseen, self._listed = timedelta(seconds=unseen_s), timedelta(seconds=listed_s)
        self.hook = hook
        self.unavailable: set[tuple[str, str]] = set()
        self.never_boot: set[str] = set()
        self.store: Bucket | None = None
        self._machines: dict[str, _Machine] = {}  # by client token
        self._groups: dict[str, GroupSeen] = {}
        self._key_pairs: dict[str, KeyPairSeen] = {}
        self._numbers = itertools.count(1)
        self._lock = threading.RLock()

    def observe(self, cluster: str | None) -> Observed:
        """Return all that exists, as it stands now."""
        with self._called("observe"):
            machines = [
                self._seen(machine)
                for machine in self._machines.values()
                if self._is_listed(machine)
            ]
            return Observed(
                tuple(seen for seen in machines if cluster in (None, seen.cluster)),
                (
                    *(group for name, group in self._groups.items() if cluster in (None, name)),
                    *(p for p in self._key_pairs.values() if cluster in (None, p.cluster)),
                ),
            )

    def prepare(self, wanted: Prerequisites, observed: Observed) -> list[Step]:
        """Plan as on a cloud that speaks EC2."""
        return plan_access(self, wanted, observed)

    def create_key_pair(self, cluster: str, incarnation: str, public_key: str) -> KeyPairSeen:
        """Make a key pair."""
        with self._called("create_key_pair"):
            name = key_pair_name(cluster, incarnation)
            pair = KeyPairSeen(cluster, name, incarnation, fingerprint=public_key)
            return self._key_pairs.setdefault(name, pair)

    def create_group(self, cluster: str, incarnation: str, owner: Owner) -> GroupSeen:
        """Make a group."""
        with self._called("create_group"):
            name = group_name(cluster)
            number = next(self._numbers)
            group = GroupSeen(cluster, name, incarnation, f"sg-{number}", owner)
            return self._groups.setdefault(cluster, group)

    def tag(
        self, machines: Sequence[MachineSeen], tags: Tags, resources: Sequence[Resource] = ()
    ) -> None:
        """Write down what some machines and groups bear."""
        with self._called("tag"):
            for machine in self._named(machines):
                seen = machine.seen
                machine.seen = replace(
                    seen,
                    owner=tags.owner or seen.owner,
                    desired=tags.desired or seen.desired,
                    lease_until=tags.lease_until or seen.lease_until,
                    set_up_by=tags.set_up_by or seen.set_up_by,
                )
            for group in resources if tags.owner else ():
                self._change(group, owner=tags.owner)

    def allow(
        self, group: GroupSeen, ssh_from: frozenset[str], internal_ports: frozenset[int]
    ) -> None:
        """Replace the rules of a group."""
        with self._called("allow"):
            self._change(group, ssh_from=ssh_from, internal_ports=internal_ports)

    def launch(self, launch: Launch) -> MachineSeen:
        """Start a machine, or return the one that the same token has started."""
        with self._called("launch"):
            attempt = f"{launch.instance_type}-{launch.market}"
            token = client_token(launch.cluster, launch.incarnation, launch.name, attempt)
            if token not in self._machines:
                if (launch.instance_type, launch.market) in self.unavailable:
                    kind = f"{launch.instance_type} ({launch.market})"
                    raise CapacityError(
                        f"{launch.name.node}: no {kind} to be had",
                        "try another instance type, market or zone",
                    )
                self._machines[token] = self._start(launch)
            return self._seen(self._machines[token])

    def terminate(self, machines: Sequence[MachineSeen]) -> None:
        """Begin to end some machines."""
        with self._called("terminate"):
            for machine in self._named(machines):
                machine.ended = machine.ended or self._now()

    def cleanup(self, resource: Resource) -> bool:
        """Delete a group or a key pair."""
        delete = self.delete_group if resource.bears_life else self.delete_key_pair
        return delete(resource)

    def delete_group(self, group: Resource) -> bool:
        """Delete a group unless a machine that is not yet gone was launched in it."""
        with self._called("delete_group"):
            if any(
                machine.seen.cluster == group.cluster and self._state(machine) is not State.GONE
                for machine in self._machines.values()
            ):
                return False
            self._groups.pop(group.cluster, None)
            return True

    def delete_key_pair(self, key_pair: Resource) -> bool:
        """Delete a key pair."""
        with self._called("delete_key_pair"):
            self._key_pairs.pop(key_pair.name, None)
            return True

    def console(self, machine: MachineSeen) -> str:
        """Return one line."""
        return f"{machine.name.node}: booting\n"

    def bucket(self) -> Bucket | None:
        """Return what a test has put there."""
        return self.store

    def interrupt(self, node: str, reason: str = "Server.SpotInstanceTermination") -> None:
        """Take the machines of a node away, as a cloud does with spot machines.

        Parameters
        ----------
        reason : str
            Why, as the cloud says it.
        """
        for machine in self._machines.values():
            if machine.seen.name.node == node and machine.ended is None:
                machine.ended, machine.seen = self._now(), replace(machine.seen, reason=reason)

    def _start(self, launch: Launch) -> _Machine:
        number, now = next(self._numbers), self._now()
        seen = MachineSeen(
            id=f"i-{number:08x}",
            cluster=launch.cluster,
            name=launch.name,
            incarnation=launch.incarnation,
            state=State.PENDING,
            public_address=f"198.51.{number >> 8 & 255}.{number & 255}",
            private_address=f"10.0.{number >> 8 & 255}.{number & 255}",
            instance_type=launch.instance_type,
            market=launch.market,
            launched=now,
            lease_until=launch.lease_until,
            owner=launch.owner,
            desired=launch.desired,
            made_as=launch.made_as,
        )
        return _Machine(seen, now)

    def _state(self, machine: _Machine) -> State:
        if machine.ended is not None:
            return State.GONE if self._now() >= machine.ended + self._end else State.ENDING
        is_up = self._now() >= machine.launched + self._boot
        return (
            State.RUNNING
            if is_up and machine.seen.name.node not in self.never_boot
            else State.PENDING
        )

    def _seen(self, machine: _Machine) -> MachineSeen:
        return replace(machine.seen, state=self._state(machine))

    def _is_listed(self, machine: _Machine) -> bool:
        now = self._now()
        is_forgotten = machine.ended is not None and now > machine.ended + self._end + self._listed
        return now >= machine.launched + self._unseen and not is_forgotten

    def _change(self, group: Resource, **values: Any) -> None:
        """Change a group by its id, as clouds do: one of the same name made later is another."""
        there = self._groups.get(group.cluster)
        if there is None or there.id != group.id:
            raise CloudError(
                f"security group {group.name} ({group.id}) is gone", "run hpcapp up again"
            )
        self._groups[group.cluster] = replace(there, **values)

    def _named(self, machines: Sequence[MachineSeen]) -> list[_Machine]:
        ids = {machine.id for machine in machines}
        return [machine for machine in self._machines.values() if machine.seen.id in ids]

    @contextmanager
    def _called(self, call: str) -> Iterator[None]:
        """Let the hook see a call on its way in and its answer on the way out."""
        if self.hook:
            self.hook("before", call)
        with self._lock:
            yield
        if self.hook:
            self.hook("after", call)
