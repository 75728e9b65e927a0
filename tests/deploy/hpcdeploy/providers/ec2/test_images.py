"""The images that a cluster file names: by id, by a parameter, by owner and name."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any

import boto3
import pytest
from pydantic import TypeAdapter, ValidationError

from hpccomponent.errors import CloudError
from hpcdeploy.providers.ec2.client import read_parameter
from hpcdeploy.providers.ec2.provider import Ec2Provider
from hpcdeploy.spec.provider import Image

from .conftest import Desk

OpenDesk = Callable[..., Desk]
NEWER = "0123456789abcdef1"


@pytest.mark.parametrize("profile", ["aws", "euca-4.0", "generic"])
def test_the_newest_of_a_name_is_taken_and_stays_for_the_command(
    open_desk: OpenDesk, profile: str
) -> None:
    desk = open_desk(profile, small={"image": {"owner": "self", "name": "debian-12*"}})
    model, kind = desk.cloud.model, "emi" if profile.startswith("euca") else "ami"
    model.add_image(f"{kind}-{NEWER}", "debian-12-of-march", datetime(2025, 3, 1))
    model.add_image(f"{kind}-0", "debian-11", datetime(2026, 1, 1))
    desk.prepare()
    desk.launch("worker-1")
    model.add_image(f"{kind}-2", "debian-12-of-may", datetime(2025, 5, 1))
    desk.launch("worker-2")
    launches = [call for call in desk.cloud.calls if call.action == "RunInstances"]
    assert {call.parameters["ImageId"] for call in launches} == {f"{kind}-{NEWER}"}
    (told,) = desk.provider.decided()
    assert f"{kind}-{NEWER} (debian-12-of-march), the newest of self called debian-12*" in told


def test_a_name_that_no_image_has_is_said(open_desk: OpenDesk) -> None:
    desk = open_desk("aws", small={"image": {"owner": "self", "name": "windows*"}})
    desk.prepare()
    with pytest.raises(CloudError, match=r"no image, the newest of self called windows\*"):
        desk.launch()
    assert any("windows" in problem.what for problem in desk.provider.check())
    assert not desk.cloud.instances


def test_a_parameter_names_the_image(
    open_desk: OpenDesk, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    desk = open_desk("aws", small={"image": {"ssm": "/images/debian"}})
    monkeypatch.setenv("AWS_ENDPOINT_URL_SSM", desk.cloud.endpoint_url)
    boto3.client("ssm", region_name="us-east-1").put_parameter(
        Name="/images/debian", Value=desk.cloud.image_id, Type="String"
    )
    spec, asked = desk.provider._cloud, []

    def read(name: str) -> str:
        asked.append(name)
        return read_parameter(spec, tmp_path, name)

    provider = Ec2Provider(spec, desk.provider._calls, 22, read)
    assert provider.decided() == (
        f"image of profile small: {desk.cloud.image_id} (debian-12), by the parameter "
        "/images/debian",
    )
    assert provider.decided()
    assert asked == ["/images/debian"]
    with pytest.raises(CloudError, match="cannot read the parameter /images/none"):
        read_parameter(spec, tmp_path, "/images/none")


@pytest.mark.parametrize("profile", ["aws", "euca-4.0"])
def test_machines_have_the_role_that_is_named(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, small={"iam_instance_profile": "workers"})
    desk.prepare()
    desk.cloud.fail("RunInstances", "InvalidParameterValue", 400)  # moto knows no such role
    with pytest.raises(CloudError):
        desk.launch()
    (call,) = [call for call in desk.cloud.calls if call.action == "RunInstances"]
    assert call.parameters["IamInstanceProfile.Name"] == "workers"


@pytest.mark.parametrize(
    "named",
    [
        {}, {"id": "ami-1", "ssm": "/a"}, {"owner": "self"}, {"name": "x"},
        {"id": "ami-1", "owner": "self", "name": "x"}, {"ssm": "no/slash"},
        {"owner": "1", "name": "x"},
    ],
)  # fmt: skip
def test_an_image_is_named_in_one_way(named: dict[str, str]) -> None:
    with pytest.raises(ValidationError):
        TypeAdapter(Image).validate_python(named)
