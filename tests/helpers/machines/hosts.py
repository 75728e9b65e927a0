"""What tests do with hosts of a cluster file."""

from __future__ import annotations

from hpcdeploy.provider import Launch
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.spec.names import NodeName


def claim(cluster: Cluster) -> None:
    for node in cluster.spec.nodes():
        cluster.provider.launch(Launch("lab", "life", NodeName(node), owner=cluster.access.owner()))
