"""What tests do with hosts of a cluster file."""

from __future__ import annotations

from hpcdeploy.cluster import Cluster
from hpcdeploy.names import NodeName
from hpcdeploy.provider import Launch


def claim(cluster: Cluster) -> None:
    for node in cluster.spec.nodes():
        cluster.provider.launch(Launch("lab", "life", NodeName(node), owner=cluster.access.owner()))
