"""What `doctor` and `plan` learn from a cloud without changing it, and disks that end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from hpccomponent.errors import CloudError
from hpcdeploy.providers.ec2.launch import root_disk

from .conftest import Desk

OpenDesk = Callable[..., Desk]
each_kind = pytest.mark.parametrize("profile", ["aws", "euca-4.0", "euca-5.1", "generic"])


@each_kind
def test_a_cloud_without_problems_is_left_unchanged(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    assert desk.provider.check() == []
    assert desk.changes() == []


@each_kind
def test_problems_are_found_all_at_once(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, small={"image": {"id": "ami-1"}, "zone": "nowhere"})
    found = " ".join(problem.what for problem in desk.provider.check())
    assert "no zone nowhere" in found
    assert "ami-1" in found
    assert all(problem.is_fatal for problem in desk.provider.check())


def test_wrong_keys_are_one_problem(open_desk: OpenDesk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk = open_desk("aws")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "wrong")
    (problem,) = desk.reopened().check()
    assert "secret key" in problem.advice


def test_a_right_to_launch_is_tried_where_the_cloud_can(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    desk.cloud.no_rights = {"RunInstances"}
    (problem,) = desk.provider.check()
    assert problem.advice == "the credentials lack the right ec2:RunInstances"
    desk = open_desk("euca-5.1")
    desk.cloud.no_rights = {"RunInstances"}
    assert desk.provider.check() == []


def test_types_that_amazon_has_not_are_found(open_desk: OpenDesk) -> None:
    desk = open_desk("aws", small={"instance_type": ["m5.large", "z9.huge"]})
    (problem,) = desk.provider.check()
    assert "instance type z9.huge of profile small" in problem.what
    assert not problem.is_fatal, "there is another one"
    desk = open_desk("aws", small={"instance_type": "z9.huge"})
    assert [problem.is_fatal for problem in desk.provider.check()] == [True]


def test_what_may_not_be_asked_stops_nothing(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    desk.cloud.no_rights = {"DescribeInstanceTypes"}
    (problem,) = desk.provider.check()
    assert "DescribeInstanceTypes" in problem.advice
    assert not problem.is_fatal


def image(ends: bool = True, size: int = 8, kind: str = "ebs") -> dict[str, Any]:
    volume = {"DeleteOnTermination": ends, "VolumeSize": size}
    return {
        "ImageId": "ami-1",
        "RootDeviceName": "/dev/sda1",
        "RootDeviceType": kind,
        "BlockDeviceMappings": [{"DeviceName": "/dev/sda1", "Ebs": volume}],
    }


def test_a_disk_that_would_be_left_behind_is_told_to_end() -> None:
    assert root_disk(image(), None) is None
    assert root_disk(image(ends=False), None) == {
        "DeviceName": "/dev/sda1",
        "Ebs": {"DeleteOnTermination": True, "VolumeSize": 8},
    }


def test_an_image_without_a_volume_has_no_size() -> None:
    with pytest.raises(CloudError, match="ami-1 has no root volume"):
        root_disk(image(kind="instance-store"), 20)
    assert root_disk({"RootDeviceType": "instance-store"}, None) is None
