"""Making the cloud as the file says, and taking it all away again.

::

    observe ──> plan ──> carry out ──> wait until it runs ──> set up ──> done
       ^                (intent, call, outcome)  │                │
       └── failed machines are replaced, within a budget <────────┘

`workers.min` decides whether a smaller cluster will do; where it will not, what this `up` made is
taken away again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpccomponent.errors import CloudError, LeftoverError
from hpcdeploy.bucket import open_bucket
from hpcdeploy.cost import check_limits, estimate_cost
from hpcdeploy.effort import Effort, Report, remove_all
from hpcdeploy.journal import open_journal
from hpcdeploy.layout import forget_cluster
from hpcdeploy.names import draw_incarnation
from hpcdeploy.pace import Pace
from hpcdeploy.plan import Plan, make_plan
from hpcdeploy.provider import Observed, State
from hpcdeploy.ssh_networks import ssh_networks

if TYPE_CHECKING:
    from hpcdeploy.cluster import Cluster

__all__ = ["bring_up", "look_ahead", "replace_lost", "take_down"]


def look_ahead(cluster: Cluster) -> Plan:
    """Return what `bring_up` would do now; nothing is changed."""
    pace = Pace()
    return make_plan(
        cluster.spec,
        cluster.provider.observe(cluster.spec.cluster),
        pace.now(),
        draw_incarnation(pace.now()),
        ssh_networks(cluster.spec),
    )


def bring_up(
    cluster: Cluster, report: Report, *, keep: bool = False, pace: Pace | None = None
) -> None:
    """Make the cloud as the file says, and set the machines up; run again, it goes on.

    Parameters
    ----------
    cluster : Cluster
    report : callable
        Takes lines for the user.
    keep : bool
        Leave what was made where the cluster cannot be made whole.
    pace : Pace, optional

    Raises
    ------
    CloudError
        Fewer machines than `workers.min` are to be had; unless `keep`, what was made is gone.
    LeftoverError
        So it is, but something is left.
    UsageError
        It may cost more than the file allows; nothing was done.
    """
    check_limits(cluster.spec, estimate_cost(cluster.spec))
    pace = pace or Pace()
    with open_journal(cluster.spec.cluster) as journal:
        if unfinished := journal.unfinished():
            report(f"not finished before: {', '.join(unfinished)}; going on from what there is")
        effort = Effort(cluster, journal, report, pace)
        before = _alive(cluster.provider.observe(cluster.spec.cluster))
        try:
            with journal.command("bring the cluster up"):
                effort.converge()
        except KeyboardInterrupt:
            report(f"what was made stays: {_ways_on(cluster)}")
            raise
        except Exception as error:
            if keep:
                report(f"what was made stays: {_ways_on(cluster)}")
                raise
            try:
                effort.undo(before)
            except CloudError as left:
                raise LeftoverError(f"{error}; besides, {left.problem}", left.advice) from None
            raise


def replace_lost(cluster: Cluster, report: Report, *, pace: Pace | None = None) -> None:
    """Start new machines for workers that have vanished, and set them up.

    Nothing else is changed, so that it may be called while a job runs; a worker that is not to be
    had is done without.

    Raises
    ------
    CloudError
        The head does not run, the cloud refuses, or another command is changing the cluster.
    """
    with open_journal(cluster.spec.cluster) as journal:
        effort = Effort(cluster, journal, report, pace or Pace(), only_replace=True)
        with journal.command("replace lost workers"):
            effort.converge()


def take_down(cluster: Cluster, report: Report, *, pace: Pace | None = None) -> None:
    """Take away all that the cloud lists of a cluster, whatever its file says by now.

    Raises
    ------
    LeftoverError
        Something is left.
    CloudError
        What its jobs have put into the bucket cannot be taken away.
    """
    with open_journal(cluster.spec.cluster) as journal:
        remove_all(cluster, journal, report, pace or Pace())
        bucket = open_bucket(cluster.spec, cluster.path.absolute().parent)
        if bucket is not None:
            with journal.step("clear the bucket"):
                bucket.clear()
        forget_cluster(cluster.spec.cluster)


def _alive(observed: Observed) -> frozenset[str]:
    """Return the ids of the machines that are not gone."""
    return frozenset(m.id for m in observed.machines if m.state is not State.GONE)


def _ways_on(cluster: Cluster) -> str:
    return f"hpcapp up {cluster.path} goes on, hpcapp down {cluster.path} ends it"
