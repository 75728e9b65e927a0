"""What every verb works on: the machines that run, the head first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from hpccomponent.config.reader import parse_config
from hpccomponent.errors import CloudError
from hpcdeploy.provider import MachineSeen, Observed, State
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import NodeName

SPEC = parse_config("version: 1\ncluster: c\nprovider: {type: local}", "c.yaml", ClusterSpec)


class Cloud:
    """Lists what it was given."""

    def __init__(self, seen: Sequence[tuple[str, State]]) -> None:
        self.seen = seen

    def observe(self, cluster: str | None) -> Observed:
        assert cluster == "c"
        return Observed(
            tuple(MachineSeen(n, "c", NodeName(n), "i", state) for n, state in self.seen)
        )


def opened(seen: Sequence[tuple[str, State]]) -> Cluster:
    provider: Any = Cloud(seen)
    access: Any = None
    return Cluster(Path("c.yaml"), SPEC, provider, access)


def test_machines_are_those_that_run_in_the_order_people_count_them() -> None:
    names = ["worker-10", "worker-2", "head", "worker-1"]
    cluster = opened([*((name, State.RUNNING) for name in names), ("worker-3", State.PENDING)])
    found = [machine.name.node for machine in cluster.machines()]
    assert found == ["head", "worker-1", "worker-2", "worker-10"]
    assert cluster.head().name.node == "head"


@pytest.mark.parametrize("seen", [[], [("head", State.ENDING), ("worker-1", State.RUNNING)]])
def test_without_a_running_head_the_cluster_is_not_up(seen: list[tuple[str, State]]) -> None:
    with pytest.raises(CloudError, match=r"cluster c is not up; run hpcapp up c\.yaml"):
        opened(seen).head()
