"""What has outlived its use, found by the cloud's own lists: no file and no memory of ours."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from datetime import datetime

from hpcdeploy.ownership.ownership import MAKING
from hpcdeploy.provider import (
    GroupSeen,
    KeyPairSeen,
    MachineSeen,
    Observed,
    Provider,
    State,
)
from hpcdeploy.reconcile.removal import remove
from hpcdeploy.reconcile.termination import Proof, Reason, is_overdue
from hpcdeploy.spec.names import incarnation_began
from hpcdeploy.spec.polling import Pace

__all__ = ["overdue", "reap", "without_lease"]


def reap(provider: Provider, report: Callable[[str], None], pace: Pace | None = None) -> None:
    """Remove what is overdue from a cloud, whoever made it.

    Raises
    ------
    LeftoverError
        Something could not be taken away.
    """
    pace = pace or Pace()

    def doomed() -> tuple[Observed, Proof]:
        now = pace.now()
        return overdue(provider.observe(None), now), Proof(now=now)

    remove(provider, doomed, Reason.OVERDUE, lambda what: nullcontext(what), report, pace)
    for machine in without_lease(provider.observe(None), pace.now()):
        report(
            f"{machine.name.node} {machine.id} of cluster {machine.cluster} runs and bears no "
            "lease: it stays, its owner's hpcapp down removes it"
        )


def overdue(observed: Observed, now: datetime) -> Observed:
    """Return what has expired or belongs to nobody; pure.

    Machines go when their lease is over or when they have shut down: nothing else proves that
    nobody uses them. A group goes with the last of its machines, a key pair with its group, or
    alone past a certain age.

    Parameters
    ----------
    observed : Observed
        Of all clusters.

    Returns
    -------
    Observed
        What is to go.
    """
    alive = [machine for machine in observed.machines if machine.state is not State.GONE]
    going = [machine for machine in alive if is_overdue(machine, now)]
    occupied = {m.cluster for m in alive if m not in going}
    spent = {(m.cluster, m.incarnation) for m in observed.machines if is_overdue(m, now)}
    groups = tuple(
        group
        for group in observed.groups
        if group.cluster not in occupied
        and ((group.cluster, group.incarnation) in spent or _is_old(group, now))
    )
    staying = {(g.cluster, g.incarnation) for g in observed.groups if g not in groups}
    pairs = tuple(
        pair
        for pair in observed.key_pairs
        if pair.cluster not in occupied
        and (pair.cluster, pair.incarnation) not in staying
        and ((pair.cluster, pair.incarnation) in spent or _is_old(pair, now))
    )
    return Observed(tuple(going), pairs, groups)


def without_lease(observed: Observed, now: datetime) -> list[MachineSeen]:
    """Return the machines that run without a lease although they are not being made any more."""
    return [
        machine
        for machine in observed.machines
        if machine.state in (State.PENDING, State.RUNNING)
        and machine.lease_until is None
        and machine.launched is not None
        and machine.launched + MAKING < now
    ]


def _is_old(seen: GroupSeen | KeyPairSeen, now: datetime) -> bool:
    began = incarnation_began(seen.incarnation)
    return began is None or began + MAKING < now
