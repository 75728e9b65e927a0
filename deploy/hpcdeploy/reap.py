"""What has outlived its use, found by the cloud's own lists: no file and no memory of ours."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from datetime import datetime, timedelta

from hpcdeploy.names import incarnation_began
from hpcdeploy.pace import Pace
from hpcdeploy.provider import GroupSeen, KeyPairSeen, MachineSeen, Observed, Provider, State
from hpcdeploy.removal import remove

__all__ = ["overdue", "reap"]

CLOCK_GRACE = timedelta(minutes=5)
"""Clocks differ: a lease is over so long after its end."""
ORPHAN_AGE = timedelta(hours=1)
"""What is younger may belong to a cluster that somebody is making right now."""


def reap(provider: Provider, report: Callable[[str], None], pace: Pace | None = None) -> None:
    """Remove what is overdue from a cloud.

    Raises
    ------
    LeftoverError
        Something could not be taken away.
    """
    pace = pace or Pace()

    def doomed() -> Observed:
        return overdue(provider.observe(None), pace.now())

    remove(provider, doomed, lambda what: nullcontext(what), report, pace)


def overdue(observed: Observed, now: datetime) -> Observed:
    """Return what has expired or belongs to nobody; pure.

    Machines go when their lease is over, when they have shut down, and, past a certain age, when
    they have no lease or no security group. A group goes with the last of its machines, a key
    pair with its group, or alone past that age.

    Parameters
    ----------
    observed : Observed
        Of all clusters.
    now : datetime
        In UTC.
    """
    clusters = {group.cluster for group in observed.groups}
    alive = [machine for machine in observed.machines if machine.state is not State.GONE]
    going = [m for m in alive if _is_overdue(m, m.cluster in clusters, now)]
    occupied = {m.cluster for m in alive if m not in going}
    spent = {(m.cluster, m.incarnation) for m in observed.machines if _is_overdue(m, True, now)}
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


def _is_overdue(machine: MachineSeen, has_group: bool, now: datetime) -> bool:
    is_old = machine.launched is not None and machine.launched + ORPHAN_AGE < now
    if machine.lease_until is None:
        return is_old
    is_over = machine.lease_until + CLOCK_GRACE < now or machine.state is State.STOPPED
    return is_over or (is_old and not has_group)


def _is_old(seen: GroupSeen | KeyPairSeen, now: datetime) -> bool:
    began = incarnation_began(seen.incarnation)
    return began is None or began + ORPHAN_AGE < now
