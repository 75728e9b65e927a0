"""What goes wrong in a cloud: a smaller cluster where `min` allows it, else one clear line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cloud import FOREVER, RSA_KEY, Instance, StrictCloud
from simulated import SetUp, open_file, stub_set_up

from hpccomponent.errors import CloudError, LeftoverError
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.reconcile.converge import bring_up, take_down
from hpcdeploy.spec.polling import Polling

POLLING = Polling(poll_s=0.01, settle_s=0.01, end_s=30.0, backoff_s=(0.01,))


class Scene:
    """A strict cloud with a cluster file of three workers, two of which will do."""

    def __init__(self, cloud: StrictCloud, folder: Path, set_up: SetUp) -> None:
        self.cloud, self.folder, self.set_up = cloud, folder, set_up
        self.lines: list[str] = []
        self.least = 2

    def cluster(self, **profile: Any) -> Cluster:
        path = self.folder / "cluster.yaml"
        provider = self.cloud.provider_block(small=profile)
        workers = {"count": 3, "min": self.least}
        path.write_text(
            json.dumps({"version": 1, "cluster": "bunny", "provider": provider, "workers": workers})
        )
        return open_file(path, RSA_KEY)

    def up(self, **profile: Any) -> None:
        bring_up(self.cluster(**profile), self.lines.append, polling=POLLING)

    def down(self) -> None:
        take_down(self.cluster(), self.lines.append, polling=POLLING)

    def nodes(self) -> list[str]:
        return sorted(
            node
            for node in ("head", "worker-1", "worker-2", "worker-3")
            for instance in self.cloud.living
            if f"-{node}-" in instance.token
        )


@pytest.fixture(params=["aws", "euca-4.0"])
def scene(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Scene]:
    with StrictCloud(request.param) as cloud:
        for name, text in cloud.environment().items():
            monkeypatch.setenv(name, text)
        yield Scene(cloud, tmp_path, stub_set_up(monkeypatch, tmp_path))


def of_node(cloud: StrictCloud, node: str) -> list[Instance]:
    return [instance for instance in cloud.instances if f"-{node}-" in instance.token]


def test_an_instance_that_dies_while_it_boots_is_replaced(scene: Scene) -> None:
    def die_once(instance: Instance) -> None:
        if instance.token.split("-")[3:6] == ["worker", "2", "1"]:
            instance.die("Server.InternalError: it did not start")

    scene.cloud.on_launch = die_once
    scene.up()
    assert scene.nodes() == ["head", "worker-1", "worker-2", "worker-3"]
    assert len(of_node(scene.cloud, "worker-2")) == 2


@pytest.mark.slow
def test_an_instance_that_always_dies_is_done_without(scene: Scene) -> None:
    def die(instance: Instance) -> None:
        if "-worker-2-" in instance.token:
            instance.die("Server.InternalError: it did not start")

    scene.cloud.on_launch = die
    scene.up()
    assert scene.nodes() == ["head", "worker-1", "worker-3"]
    assert scene.lines[-1].startswith("going without worker-2: it ended while it booted")
    scene.down()
    assert scene.cloud.left() == []


@pytest.mark.slow
def test_a_head_that_cannot_be_set_up_fails_and_leaves_nothing(scene: Scene) -> None:
    scene.set_up.broken_nodes = {"head"}
    with pytest.raises(CloudError, match=r"^head cannot be had: pip is missing; look at hpcapp"):
        scene.up()
    assert scene.cloud.left() == []


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_head_that_has_ended_is_made_anew(scene: Scene, is_stopped: bool) -> None:
    scene.up()
    [head] = of_node(scene.cloud, "head")
    head.shut_down() if is_stopped else head.die("Server.InternalError")
    scene.up()
    assert scene.nodes() == ["head", "worker-1", "worker-2", "worker-3"]
    assert len(of_node(scene.cloud, "head")) == 2


def test_an_exhausted_subnet_fails_with_its_reason_and_leaves_nothing(scene: Scene) -> None:
    scene.cloud.fail("RunInstances", "InsufficientFreeAddressesInSubnet", 400, times=FOREVER)
    with pytest.raises(CloudError, match=r"cannot be had: .*larger provider\.subnet"):
        scene.up()
    assert scene.cloud.left() == []


def test_an_exhausted_subnet_makes_a_smaller_cluster(scene: Scene) -> None:
    def exhaust(instance: Instance) -> None:
        code = "InsufficientFreeAddressesInSubnet"
        scene.cloud.fail("RunInstances", code, 400, times=FOREVER)

    scene.cloud.on_launch = exhaust
    scene.least = 0
    scene.up()
    assert scene.nodes() == ["head"]
    assert sum(line.startswith("going without worker-") for line in scene.lines) == 3


ZONES = ("us-east-1a", "us-east-1b", "us-east-1c")


def place_of(cloud: StrictCloud, name: str) -> set[str]:
    calls = (call for call in cloud.calls if call.action == "RunInstances")
    return {call.parameters.get(name, "") for call in calls}


@pytest.mark.slow
def test_a_zone_without_capacity_leads_to_the_next(scene: Scene) -> None:
    for zone in ZONES[:2]:
        match = {"Placement.AvailabilityZone": zone}
        code = "InsufficientInstanceCapacity"
        scene.cloud.fail("RunInstances", code, 500, match=match, times=FOREVER)
    scene.up(zone=list(ZONES))
    assert scene.nodes() == ["head", "worker-1", "worker-2", "worker-3"]
    assert place_of(scene.cloud, "Placement.AvailabilityZone") == set(ZONES)
    assert sum(f", {ZONES[2]})" in line for line in scene.lines if "launched" in line) == 4
    scene.down()
    assert scene.cloud.left() == []


@pytest.mark.slow
def test_a_lost_answer_in_a_zone_is_asked_for_again_there(scene: Scene) -> None:
    scene.cloud.lose("RunInstances")
    scene.up(zone=list(ZONES))
    assert scene.nodes() == ["head", "worker-1", "worker-2", "worker-3"]
    assert len(scene.cloud.instances) == 4
    assert place_of(scene.cloud, "Placement.AvailabilityZone") == {ZONES[0]}


@pytest.mark.slow
def test_throttling_and_lost_answers_are_outlasted(scene: Scene) -> None:
    scene.cloud.fail("RunInstances", "RequestLimitExceeded", 503, times=2)
    scene.cloud.lose("CreateSecurityGroup")
    scene.cloud.lose("ImportKeyPair")
    scene.up()
    assert scene.nodes() == ["head", "worker-1", "worker-2", "worker-3"]
    scene.down()
    assert scene.cloud.left() == []


@pytest.mark.slow
def test_a_group_that_cannot_be_deleted_yet_is_waited_for(scene: Scene) -> None:
    scene.up()
    code = "DependencyViolation" if scene.cloud.profile == "aws" else "InvalidGroup.InUse"
    scene.cloud.fail("DeleteSecurityGroup", code, 400, times=3)
    scene.down()
    assert scene.cloud.left() == []


@pytest.mark.slow
def test_a_group_that_can_never_be_deleted_is_named(scene: Scene) -> None:
    scene.up()
    code = "DependencyViolation" if scene.cloud.profile == "aws" else "InvalidGroup.InUse"
    scene.cloud.fail("DeleteSecurityGroup", code, 400, times=FOREVER)
    with pytest.raises(LeftoverError, match=r"still there: .*security group hpcapp-bunny"):
        take_down(scene.cluster(), scene.lines.append, polling=replace(POLLING, end_s=1.0))


@pytest.mark.slow
@pytest.mark.parametrize("code", ["AuthFailure", "RequestExpired", "ExpiredToken"])
def test_wrong_or_expired_credentials_are_one_line_before_anything_is_made(
    scene: Scene, code: str
) -> None:
    scene.cloud.fail("*", code, 401, times=FOREVER)
    with pytest.raises(CloudError) as caught:
        scene.up()
    assert "\n" not in str(caught.value)
    assert caught.value.advice
    assert not [call for call in scene.cloud.calls if call.changes]


@pytest.mark.parametrize("action", ["CreateSecurityGroup", "ImportKeyPair", "RunInstances"])
def test_a_right_that_is_lacking_is_named_and_nothing_is_left(scene: Scene, action: str) -> None:
    scene.cloud.no_rights = {action}
    with pytest.raises(CloudError, match=action):
        scene.up()
    assert scene.cloud.left() == []


def test_what_may_not_be_ended_is_named(scene: Scene) -> None:
    scene.up()
    scene.cloud.no_rights = {"TerminateInstances"}
    with pytest.raises(LeftoverError, match=r"still there: .*head i-.*TerminateInstances.*"):
        scene.down()
