"""`status` and `ls`: what the cloud lists, for people and for programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from simulated import make_cluster, make_spec, stub_set_up
from simulated.memory import MemoryProvider

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import Completed
from hpcdeploy.reconcile.converge import bring_up, take_down
from hpcdeploy.reconcile.status import describe_cluster, list_clusters, write_list, write_table
from hpcdeploy.spec.names import NOBODY
from hpcdeploy.spec.polling import utc_now


class Machine:
    """Answers what a shell's commands would."""

    def __init__(self, answer: Completed) -> None:
        self.answer = answer

    def run(self, command: str, **about: Any) -> Completed:
        return self.answer

    def __enter__(self) -> Machine:
        return self

    def __exit__(self, *about: object) -> None:
        pass


@pytest.fixture
def cloud(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MemoryProvider:
    stub_set_up(monkeypatch, tmp_path)
    return MemoryProvider(utc_now)


def cluster_on(cloud: MemoryProvider, count: int = 1) -> Any:
    return make_cluster(make_spec(count), cloud)


def test_a_cluster_that_is_up(cloud: MemoryProvider) -> None:
    cluster = cluster_on(cloud)
    bring_up(cluster, lambda line: None)
    answers = {"head": Completed(0, "0.1.0\n", ""), "worker-1": Completed(3, "", "")}
    cluster.access.open = lambda machine, timeout_s: Machine(answers[machine.name.node])
    found = describe_cluster(cluster)
    assert json.loads(json.dumps(found)) == found
    assert found["is_up"]
    assert [m["loader"] for m in found["machines"]] == ["0.1.0", "not running"]
    assert found["machines"][0]["lease_left_s"] == pytest.approx(7195, abs=5)
    table = write_table(found).splitlines()
    assert table[0] == "cluster bunny (memory): up"
    assert table[1].startswith("cost: $0.27")
    assert table[2].split()[2:4] == ["TYPE", "MARKET"]
    assert table[3].split()[:4] == ["head", "running", "m6i.large", "on_demand"]
    assert table[3].split()[-2:] == ["1h59", "0.1.0"]


def test_machines_that_nobody_rents_have_no_columns_for_it(cloud: MemoryProvider) -> None:
    bring_up(cluster_on(cloud), lambda line: None)
    found = describe_cluster(cluster_on(cloud), ask_machines=False)
    found["hourly_cost"] = None
    for machine in found["machines"]:
        machine["instance_type"], machine["lease_left_s"] = "", None
    heading = write_table(found).splitlines()[1]
    assert heading.split() == ["NODE", "STATE", "PUBLIC", "PRIVATE", "AGE"]


def test_a_machine_that_does_not_answer_says_why(cloud: MemoryProvider) -> None:
    cluster = cluster_on(cloud)
    bring_up(cluster, lambda line: None)

    def refuse(machine: Any, timeout_s: float) -> Machine:
        raise CloudError(f"{machine.name.node} refuses SSH", "look at its console")

    cluster.access.open = refuse
    found = describe_cluster(cluster)
    assert found["machines"][1]["loader"] == "worker-1 refuses SSH"


def test_what_is_missing_is_named_without_asking_machines(cloud: MemoryProvider) -> None:
    bring_up(cluster_on(cloud, 1), lambda line: None)
    found = describe_cluster(cluster_on(cloud, 2), ask_machines=False)
    assert write_table(found).startswith(
        "cluster bunny (memory): up, without worker-2 of the file (hpcapp up launches"
    )


def test_after_scale_it_is_said_what_differs_from_the_file(cloud: MemoryProvider) -> None:
    bring_up(cluster_on(cloud, 3), lambda line: None)
    found = describe_cluster(cluster_on(cloud, 1), ask_machines=False)
    assert (found["is_up"], found["unwanted"]) == (True, ["worker-2", "worker-3"])
    assert write_table(found).startswith(
        "cluster bunny (memory): up, with worker-2, worker-3 beyond the file (hpcapp up ends"
    )


def test_without_its_head_a_cluster_is_not_up(cloud: MemoryProvider) -> None:
    bring_up(cluster_on(cloud, 1), lambda line: None)
    cloud.interrupt("head")
    found = describe_cluster(cluster_on(cloud, 1), ask_machines=False)
    assert write_table(found).startswith("cluster bunny (memory): not up: head does not run\n")


def test_a_cluster_that_is_down(cloud: MemoryProvider) -> None:
    found = describe_cluster(cluster_on(cloud), ask_machines=False)
    assert write_table(found) == "cluster bunny (memory): not up, missing: head, worker-1"


def test_every_cluster_of_a_cloud_is_listed_even_what_is_left_of_one(
    tmp_path: Path, cloud: MemoryProvider
) -> None:
    bring_up(cluster_on(cloud), lambda line: None)
    cloud.create_group("forgotten", "life", NOBODY)
    spec = make_spec().provider.cloud
    assert spec is not None
    rows = list_clusters("here", cloud.observe(None), spec)
    assert [row["cluster"] for row in rows] == ["bunny", "forgotten"]
    assert rows[0]["states"] == {"running": 2}
    assert rows[0]["instance_types"] == ["c6i.xlarge", "m6i.large"]
    text = write_list(rows).splitlines()
    assert text[1].split()[:6] == ["bunny", "here", "2", "running", "c6i.xlarge,", "m6i.large"]
    assert text[1].split()[6:] == ["$0.2778", "1h59"]
    assert rows[0]["hourly_cost"] == describe_cluster(cluster_on(cloud), False)["hourly_cost"]
    assert text[2].split()[-2:] == ["-", "-"]
    take_down(cluster_on(cloud), lambda line: None)
    assert [row["cluster"] for row in list_clusters("here", cloud.observe(None))] == ["forgotten"]
    assert write_list([]) == "no clusters"
