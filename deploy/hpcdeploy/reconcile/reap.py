"""What has outlived its use, found by the cloud's own lists: no file and no memory of ours."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from datetime import datetime

from hpcdeploy.ownership.ownership import MAKING
from hpcdeploy.provider import (
    MachineSeen,
    Observed,
    Provider,
    Resource,
    State,
)
from hpcdeploy.reconcile.removal import remove
from hpcdeploy.reconcile.termination import Proof, Reason, is_overdue
from hpcdeploy.spec.names import incarnation_began
from hpcdeploy.spec.polling import Polling


def reap(provider: Provider, report: Callable[[str], None], polling: Polling | None = None) -> None:
    """Remove what is overdue from a cloud, whoever made it.

    Raises LeftoverError where something could not be taken away.
    """
    polling = polling or Polling()

    def doomed() -> tuple[Observed, Proof]:
        now = polling.now()
        return overdue(provider.observe(None), now), Proof(now=now)

    remove(provider, doomed, Reason.OVERDUE, lambda what: nullcontext(what), report, polling)
    for machine in without_lease(provider.observe(None), polling.now()):
        report(
            f"{machine.name.node} {machine.id} of cluster {machine.cluster} runs and bears no "
            "lease: it stays, its owner's hpcapp down removes it"
        )


def overdue(observed: Observed, now: datetime) -> Observed:
    """Return what of all clusters is to go, as it has expired or belongs to nobody; pure.

    Machines go when their lease is over or when they have shut down: nothing else proves that
    nobody uses them. A resource that bears a life goes with the last of its machines, the others of
    that life with it, or alone past a certain age.
    """
    alive = [machine for machine in observed.machines if machine.state is not State.GONE]
    going = [machine for machine in alive if is_overdue(machine, now)]
    occupied = {m.cluster for m in alive if m not in going}
    spent = {(m.cluster, m.incarnation) for m in observed.machines if is_overdue(m, now)}
    idle = [
        resource
        for resource in observed.resources
        if resource.cluster not in occupied
        and ((resource.cluster, resource.incarnation) in spent or _is_old(resource, now))
    ]
    staying = {(life.cluster, life.incarnation) for life in observed.lives if life not in idle}
    resources = (r for r in idle if (r.cluster, r.incarnation) not in staying)
    return Observed(tuple(going), tuple(resources))


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


def _is_old(seen: Resource, now: datetime) -> bool:
    began = incarnation_began(seen.incarnation)
    return began is None or began + MAKING < now
