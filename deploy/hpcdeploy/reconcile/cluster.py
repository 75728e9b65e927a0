"""An opened cluster file: what every verb works on."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError, OutdatedError
from hpcdeploy.ownership.journal import peek_journal
from hpcdeploy.ownership.ownership import Ownership, foreign_owner
from hpcdeploy.provider import MachineSeen, Observed, Provider, Resource, State
from hpcdeploy.providers.clouds import places_of
from hpcdeploy.spec.cluster import ClusterSpec, read_spec
from hpcdeploy.spec.layout import state_folder
from hpcdeploy.spec.names import HEAD, Owner
from hpcdeploy.spec.polling import utc_now

if TYPE_CHECKING:
    from hpcdeploy.login.access import Access


log = logging.getLogger("hpcapp")

PLACES_TOLD = 5


@dataclass(frozen=True, slots=True)
class Cluster:
    """A cluster file with the way to its cloud and to its machines."""

    path: Path
    spec: ClusterSpec
    provider: Provider
    access: Access

    def machines(self) -> tuple[MachineSeen, ...]:
        """Return the machines that run, from the cloud: the head first, then by number.

        Raises CloudError where the cluster was made elsewhere.
        """
        return tuple(m for m in self.present() if m.state is State.RUNNING)

    def present(self) -> tuple[MachineSeen, ...]:
        """Return the machines that are there, whether they run and show themselves or not.

        Raises CloudError where the cluster was made elsewhere.
        """
        observed = self.provider.observe(self.spec.cluster)
        require_ours(self, observed)
        nodes = self.spec.nodes()
        ending = (State.ENDING, State.GONE)
        present = (m for m in observed.machines if m.state not in ending)
        # A host that hides what it does counts where the file wants it: it may be none of ours.
        counted = (m for m in present if m.state is not State.UNKNOWN or m.name.node in nodes)
        return tuple(sorted(counted, key=node_order))

    def head(self) -> MachineSeen:
        """Return the machine of the HPC App.

        Raises CloudError where none is seen to run, or the cluster was made elsewhere.
        """
        heads = [machine for machine in self.present() if machine.name.node == HEAD]
        for head in heads:
            if head.state is State.RUNNING:
                return head
        for head in heads:
            raise describe_silent(head)
        raise CloudError(f"cluster {self.spec.cluster} is not up", f"run hpcapp up {self.path}")


def describe_silent(machine: MachineSeen) -> CloudError:
    """Return why nothing can be done on a machine that is there and is not seen to run."""
    where = f"{machine.name.node} ({machine.id})"
    if machine.state is State.UNKNOWN:
        return CloudError(f"{where} cannot be looked at: {machine.reason}")
    why = f" ({machine.reason})" if machine.reason else ""
    return CloudError(f"{where} does not run: it is {machine.state}{why}")


def as_desired(
    cluster: Cluster, observed: Observed, report: Callable[[str], None] = lambda _: None
) -> Cluster:
    """Return a cluster with the number of workers of the last `up` or `scale`, or of the file.

    `report` is told where that is another number than before.
    """
    name, before = cluster.spec.cluster, cluster.spec.worker_count
    latest = observed.desired(name)
    if latest is None or latest.workers == before:
        return cluster
    word = "grew" if latest.workers > before else "shrank"
    report(
        f"cluster {name} {word} from {before} to {latest.workers} workers, by the last hpcapp "
        "scale or up"
    )
    return replace(cluster, spec=cluster.spec.scaled(latest.workers))


def node_order(machine: MachineSeen) -> tuple[bool, int, str, int]:
    """Return the key to sort machines by: the head first, worker-2 before worker-10."""
    node = machine.name.node
    return node != HEAD, len(node), node, machine.name.generation


@contextmanager
def open_cluster(path: Path) -> Iterator[Cluster]:
    """Read a cluster file and open its provider; close the shells at the end.

    Where the cluster lives elsewhere besides, that is said first, whatever the provider answers.
    Raises CloudError where the cloud's keys are not to be found.
    """
    from hpcdeploy.login.access import Access  # it imports paramiko, which is slow
    from hpcdeploy.providers import open_provider

    spec = read_spec(path)
    base = path.absolute().parent
    provider = open_provider(spec, base)
    access = Access(spec, base, provider)
    cluster = Cluster(path, spec, provider, access)
    if elsewhere := describe_elsewhere(cluster):
        log.warning("warning: %s", elsewhere)
    try:
        yield cluster
    finally:
        access.close()


def require_ours(cluster: Cluster, observed: Observed, now: datetime | None = None) -> None:
    """Refuse a cluster that was made elsewhere; where there is nothing yet it is ours to make.

    `now` is in UTC, the present by default. Raises CloudError, which says by whom it was made, and
    how to share it or take it over.
    """
    if not cluster.spec.provider.is_shared or not _is_any(observed):
        return
    ownership = cluster.access.ownership()
    owner = foreign_owner(observed, ownership, now or utc_now())
    if owner is not None:
        raise CloudError(describe_foreign(cluster.spec.cluster, owner, ownership), _advice(cluster))


def require_same(cluster: Cluster, before: Observed, now: Observed) -> None:
    """Refuse a cluster that is not the one which the user has agreed about.

    `before` is of when the user was asked, `now` of when it is to be done. Raises OutdatedError
    where machines or groups have come, or have another owner; those that are gone do not matter.
    """
    if not _bearers(now) <= _bearers(before):
        raise OutdatedError(
            f"cluster {cluster.spec.cluster} has changed meanwhile: it has machines or an owner "
            "that you were not asked about",
            "run the command again",
        )


def _bearers(observed: Observed) -> set[tuple[str, str, str]]:
    """Return what bears a life and an owner, with both."""
    ending = (State.ENDING, State.GONE)
    bearers: list[MachineSeen | Resource] = [*observed.lives]
    bearers += [machine for machine in observed.machines if machine.state not in ending]
    return {(seen.id, seen.incarnation, str(seen.owner)) for seen in bearers}


def describe_elsewhere(cluster: Cluster) -> str:
    """Say where a cluster lives besides, after its file was changed.

    Only the journal of this machine tells; empty where it knows of no other place.
    """
    name, file = cluster.spec.cluster, cluster.path
    known = peek_journal(name).places
    here = places_of(cluster.spec) if known else ()
    others = [place for place in known if place not in here]
    if not others:
        return ""
    more = f" and {len(others) - PLACES_TOLD} more places" if len(others) > PLACES_TOLD else ""
    return (
        f"cluster {name} was made in {', '.join(others[:PLACES_TOLD])}{more}, where {file} does "
        "not lead any more: what is there stays; to remove it, let the file lead there again and "
        f"run hpcapp down {file}"
    )


def describe_foreign(name: str, owner: Owner, ownership: Ownership) -> str:
    """Say whose a cluster is, and what this machine holds of it, in one line."""
    by = owner.user or "somebody"
    key = f"with the key {owner.key}" if owner.key else "without a trace of its key"
    here = (
        f"the key here is {ownership.owner.key}"
        if ownership.owner.key
        else "there is no key of it here"
    )
    return f"cluster {name} was made elsewhere: by {by} {key}; {here}"


def _advice(cluster: Cluster) -> str:
    spec, file = cluster.spec, cluster.path
    folder = state_folder(spec.cluster)
    if not spec.provider.makes_machines:
        share, key = f"put its owner's keys.json into {folder}", ""
    elif spec.auth.ssh_private_key == "auto":
        share, key = f"put its owner's key into {folder / 'id'} (mode 0600)", " --key KEY"
    else:
        share, key = "name its owner's key as auth.ssh_private_key", ""
    return (
        f"to share it, {share}; to take it over, hpcapp adopt {file}{key}; "
        f"to remove it, hpcapp down {file}; or give yours another name"
    )


def _is_any(observed: Observed) -> bool:
    return bool(observed.machines or observed.lives)
