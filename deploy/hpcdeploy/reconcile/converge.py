"""Making the cloud as the file says, and taking it all away again.

::

    observe ──> plan ──> carry out ──> wait until it runs ──> set up ──> done
       ^                (intent, call, outcome)  │                │
       └── failed machines are replaced, within a budget <────────┘

`workers.min` decides whether a smaller cluster will do; where it will not, what this `up` made is
taken away again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hpccomponent.errors import CloudError, HpcError, LeftoverError, OutdatedError
from hpcdeploy.ownership.journal import Journal, open_journal, peek_journal
from hpcdeploy.ownership.ownership import Ownership, ours
from hpcdeploy.provider import Observed, State
from hpcdeploy.providers.clouds import places_of
from hpcdeploy.reconcile.cluster import (
    as_desired,
    describe_elsewhere,
    require_ours,
    require_same,
)
from hpcdeploy.reconcile.cost import check_limits, estimate_cost
from hpcdeploy.reconcile.plan import LIVE, ClusterPlan
from hpcdeploy.reconcile.reconciler import Reconciler, Report
from hpcdeploy.reconcile.removal import remove
from hpcdeploy.reconcile.termination import Proof, Reason
from hpcdeploy.spec.layout import forget_cluster
from hpcdeploy.spec.polling import Polling

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster


def look_ahead(cluster: Cluster) -> ClusterPlan:
    """Return what `bring_up` would do now; nothing is changed.

    Raises CloudError where the cluster was made elsewhere.
    """
    journal = peek_journal(cluster.spec.cluster)
    return Reconciler(cluster, journal, lambda _: None, Polling()).plan()


def bring_up(
    cluster: Cluster,
    report: Report,
    *,
    keep: bool = False,
    polling: Polling | None = None,
    agreed: ClusterPlan | None = None,
) -> None:
    """Make the cloud as the file says, and set the machines up; run again, it goes on.

    With `keep`, what was made stays where the cluster cannot be made whole. `agreed` is what the
    user has agreed to; by default whatever is planned.

    Raises
    ------
    OutdatedError
        More would be done than was agreed to; nothing was done.
    CloudError
        The cluster was made elsewhere, or its head lets nobody in, and nothing was done; or fewer
        machines than `workers.min` are to be had, and unless `keep`, what was made is gone.
    LeftoverError
        So it is, but something is left.
    UsageError
        It may cost more than the file allows; nothing was done.
    """
    check_limits(cluster.spec, estimate_cost(cluster.spec))
    polling = polling or Polling()
    require_ours(cluster, cluster.provider.observe(cluster.spec.cluster), polling.now())
    with open_journal(cluster.spec.cluster) as journal:
        if unfinished := journal.unfinished():
            report(f"not finished before: {', '.join(unfinished)}; going on from what there is")
        reconciler = Reconciler(cluster, journal, report, polling)
        plan = reconciler.first_plan()
        if agreed is not None and (beyond := plan.beyond(agreed)):
            raise OutdatedError(
                f"cluster {cluster.spec.cluster} has changed meanwhile: {'; '.join(beyond)}, which "
                "was not agreed to",
                "look at the plan again",
            )
        try:
            with journal.command("bring the cluster up"):
                reconciler.converge(plan)
        except KeyboardInterrupt:
            report(f"what was made stays: {_ways_on(cluster)}")
            raise
        except Exception as error:
            if keep:
                report(f"what was made stays: {_ways_on(cluster)}")
                raise
            try:
                reconciler.undo(error.problem if isinstance(error, HpcError) else str(error))
            except CloudError as leftover:
                raise LeftoverError(
                    f"{error}; besides, {leftover.problem}", leftover.advice
                ) from None
            except KeyboardInterrupt:
                report(f"not all that was made is gone: hpcapp down {cluster.path} removes it")
                report(str(error))
                raise
            raise


def replace_lost(
    cluster: Cluster,
    report: Report,
    *,
    polling: Polling | None = None,
    seen: Observed | None = None,
) -> Cluster:
    """Start new machines for workers that have vanished, and set them up.

    Nothing else is changed, so that it may be called while a job runs; a worker that is not to be
    had is done without. How many there are to be says the last `up` or `scale`, not the file.
    `seen` is the cluster as it was just now; by default it is looked at.

    Raises CloudError where the head does not run, the cloud refuses, or another command is changing
    the cluster; UsageError where so many workers may cost more than the file allows.
    """
    seen = seen or cluster.provider.observe(cluster.spec.cluster)
    cluster = as_desired(cluster, seen, report)
    live = {machine.name.node for machine in seen.machines if machine.state in LIVE}
    if set(cluster.spec.nodes()) <= live and not peek_journal(cluster.spec.cluster).unfinished():
        return cluster  # and no other command finds the journal locked
    check_limits(cluster.spec, estimate_cost(cluster.spec))
    with open_journal(cluster.spec.cluster) as journal:
        reconciler = Reconciler(cluster, journal, report, polling or Polling(), only_replace=True)
        with journal.command("replace lost workers"):
            reconciler.converge(reconciler.first_plan())
    return replace(cluster, spec=reconciler.spec)


def take_down(
    cluster: Cluster,
    report: Report,
    *,
    polling: Polling | None = None,
    named: Observed | None = None,
) -> None:
    """Take away all that the cloud lists of a cluster, whatever its file says by now.

    `named` is the cluster as it was when the user named it, so that it goes although it was made
    elsewhere.

    Raises OutdatedError where it is another one by now, and nothing was done; LeftoverError where
    something is left, here or where an earlier file made it; CloudError where the cluster was made
    elsewhere and not named, or what its jobs have put into the bucket cannot be taken away.
    """
    polling = polling or Polling()
    seen = cluster.provider.observe(cluster.spec.cluster)
    if named is None:
        require_ours(cluster, seen, polling.now())
    else:
        require_same(cluster, named, seen)
    with open_journal(cluster.spec.cluster) as journal:
        _remove_all(cluster, journal, seen, report, polling)
        bucket = cluster.provider.bucket()
        if bucket is not None:
            with journal.step("clear the bucket"):
                bucket.clear()
        journal.clear_places(places_of(cluster.spec))
        if elsewhere := describe_elsewhere(cluster):
            raise LeftoverError(f"nothing is left where {cluster.path} leads, but {elsewhere}")
        forget_cluster(cluster.spec.cluster)


def _remove_all(
    cluster: Cluster, journal: Journal, seen: Observed, report: Report, polling: Polling
) -> None:
    """Take away what was seen, and what is ours; not what others make of this name meanwhile."""
    lives = frozenset(machine.incarnation for machine in seen.machines)
    lives |= {resource.incarnation for resource in seen.resources}

    def doomed() -> tuple[Observed, Proof]:
        now = cluster.provider.observe(cluster.spec.cluster)
        ownership = cluster.access.ownership()
        return _doomed(now, ownership, lives), Proof(ours=ours(now, ownership), lives=lives)

    looks = 3 if cluster.provider.makes_machines and journal.unfinished() else 1
    remove(cluster.provider, doomed, Reason.DOWN, journal.step, report, polling, looks)


def _doomed(seen: Observed, ownership: Ownership, lives: frozenset[str]) -> Observed:
    own_machines = ours(seen, ownership)
    lives |= ownership.lives
    machines = tuple(
        m
        for m in seen.machines
        if m.id in own_machines or m.incarnation in lives or m.state is State.UNKNOWN
    )
    lives |= {machine.incarnation for machine in machines}
    lives |= {
        r.incarnation for r in seen.lives if r.owner.key and r.owner.key == ownership.owner.key
    }
    return Observed(machines, tuple(r for r in seen.resources if r.incarnation in lives))


def _ways_on(cluster: Cluster) -> str:
    return f"hpcapp up {cluster.path} goes on, hpcapp down {cluster.path} ends it"
