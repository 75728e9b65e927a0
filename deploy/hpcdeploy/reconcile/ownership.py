"""Refuses clusters that were made elsewhere, and says how to share or take over one."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

from hpccomponent.errors import CloudError
from hpcdeploy.machine.ownership import Held, foreign_owner
from hpcdeploy.machine.provider import GroupSeen, MachineSeen, Observed
from hpcdeploy.spec.layout import state_folder
from hpcdeploy.spec.names import Owner
from hpcdeploy.spec.polling import utc_now

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster

__all__ = ["require_ours"]


def require_ours(cluster: Cluster, observed: Observed, now: datetime | None = None) -> None:
    """Refuse a cluster that was made elsewhere; where there is nothing yet it is ours to make.

    Parameters
    ----------
    cluster : Cluster
    observed : Observed
        Of that cluster.
    now : datetime, optional
        In UTC; the present by default.

    Raises
    ------
    CloudError
        It says by whom, and how to share the cluster or take it over.
    """
    if not cluster.spec.provider.is_shared or not _is_any(observed):
        return
    held = cluster.access.held()
    owner = foreign_owner(observed, held, now or utc_now())
    if owner is not None:
        raise CloudError(describe_foreign(cluster.spec.cluster, owner, held), _advice(cluster))


def describe_foreign(name: str, owner: Owner, held: Held) -> str:
    """Say whose a cluster is, and what is held here, in one line."""
    by = owner.user or "somebody"
    key = f"with the key {owner.key}" if owner.key else "without a trace of its key"
    here = f"the key here is {held.owner.key}" if held.owner.key else "there is no key of it here"
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
    things: tuple[tuple[MachineSeen, ...], tuple[GroupSeen, ...]]
    things = (observed.machines, observed.groups)
    return any(things)
