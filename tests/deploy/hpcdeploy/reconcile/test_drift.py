"""What of a machine that lives differs from the file: found for every key that cannot change."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from simulated import START, make_spec

from hpcdeploy.provider import MachineSeen, State
from hpcdeploy.reconcile.drift import describe_drift, find_drift, made_as
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import NodeName
from hpcdeploy.spec.provider import Image

FILE = Path("cluster.yaml")


def launched_by(spec: ClusterSpec, node: str = "worker-1", **more: Any) -> MachineSeen:
    """A machine as a cloud lists it that was launched by a file."""
    profile = spec.profile(node)
    assert profile is not None
    machine = MachineSeen(
        f"i-{node}",
        "bunny",
        NodeName(node),
        "life",
        State.RUNNING,
        instance_type=profile.instance_types[0],
        zone="us-east-1a",
        image=profile.image.id or "ami-found",
        subnet="subnet-1",
        lease_until=START,
        made_as=made_as(spec, node),
    )
    return replace(machine, **more)


def changed(spec: ClusterSpec, path: str, value: Any) -> ClusterSpec:
    """Return a file with one value changed, by the path of its key."""
    if path.startswith("profile."):
        profiles = spec.profiles()
        update = {path.removeprefix("profile."): value}
        profiles = profiles | {"fast": profiles["fast"].model_copy(update=update)}
        path, value = "provider.profiles", profiles
    block, _, key = path.partition(".")
    if key:
        value = getattr(spec, block).model_copy(update={key: value})
    return spec.model_copy(update={block: value})


def test_a_machine_that_is_as_the_file_says_does_not_drift() -> None:
    for market in ("on_demand", "spot_with_fallback"):
        spec = make_spec(market=market)
        for node in ("head", "worker-1"):
            assert find_drift(spec, launched_by(spec, node)) == []
    spec = make_spec(market="spot_with_fallback")
    second = launched_by(spec, instance_type="c6a.xlarge", market="spot")
    assert find_drift(spec, second) == []


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("profile.instance_type", "m7i.large", "instance_type is c6i.xlarge, not m7i.large"),
        ("profile.market", "spot", "market is on_demand, not spot"),
        ("profile.zone", ("eu-1a", "eu-1b"), "zone is us-east-1a, not eu-1a or eu-1b"),
        ("profile.image", Image(id="ami-2"), "image is ami-1, not ami-2"),
        ("profile.image", Image(ssm="/aws/x"), "image is not what the file says"),
        ("profile.disk_gb", 40, "disk_gb is left to the cloud, not 40"),
        ("profile.public_ip", False, "public_ip is left to the cloud, not false"),
        ("profile.iam_instance_profile", "role", "iam_instance_profile is not what the file says"),
        ("provider.subnet", "subnet-2", "provider.subnet is subnet-1, not subnet-2"),
        ("limits.idle", 60.0, "limits.idle is 900, not 60"),
        ("communicator.port", 7071, "communicator.port is 7070, not 7071"),
        ("auth.ssh_port", 2222, "auth.ssh_port is 22, not 2222"),
        ("auth.ssh_user", "ubuntu", "auth.ssh_user is not what the file says"),
        ("tags", {"project": "x"}, "tags is not what the file says"),
    ],
)
def test_each_key_that_cannot_change_is_told(path: str, value: Any, said: str) -> None:
    spec = make_spec()
    assert find_drift(changed(spec, path, value), launched_by(spec)) == [said]


def test_of_a_machine_of_an_older_release_what_its_cloud_lists_is_told() -> None:
    spec = make_spec()
    old = launched_by(spec, made_as="", image="", subnet="")
    assert find_drift(changed(spec, "profile.disk_gb", 40), old) == []
    other = changed(spec, "profile.instance_type", "m7i.large")
    assert find_drift(other, old) == ["instance_type is c6i.xlarge, not m7i.large"]


def test_machines_that_drift_alike_have_one_line_and_the_last_says_what_to_do() -> None:
    spec = make_spec(2)
    workers = [launched_by(spec, f"worker-{number}") for number in (1, 2)]
    other = changed(spec, "profile.instance_type", "m7i.large")
    machines = [launched_by(spec, "head"), *workers]
    told, way = describe_drift(other, machines, FILE)
    assert told.startswith("drift: worker-1 (i-worker-1), worker-2 (i-worker-2): instance_type is")
    assert "hpcapp scale cluster.yaml 0 and then hpcapp up cluster.yaml" in way
    everywhere = changed(other, "limits.idle", 60.0)
    assert (
        "hpcapp down cluster.yaml and then hpcapp up"
        in describe_drift(everywhere, machines, FILE)[-1]
    )
    assert describe_drift(spec, machines, FILE) == []


def test_the_tag_fits_every_cloud() -> None:
    spec = changed(make_spec(), "profile.iam_instance_profile", "arn:aws:iam::" + "1" * 200)
    assert len(made_as(changed(spec, "auth.ssh_user", "u" * 300), "worker-1")) < 256
