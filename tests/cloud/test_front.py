"""The front refuses what the real clouds refuse: each rule is shown to bite."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator
from typing import Any

import boto3
import pytest
from botocore.config import Config
from botocore.exceptions import ClientError, ConnectionClosedError
from cloud import FOREVER, Call, CutError, StrictCloud


def rsa_key(bits: int) -> bytes:
    parts = (b"ssh-rsa", b"\1\0\1", b"\0" + b"\xc5" * (bits // 8))
    body = b"".join(len(part).to_bytes(4, "big") + part for part in parts)
    return b"ssh-rsa " + base64.b64encode(body)


Connect = Callable[..., tuple[StrictCloud, Any]]


@pytest.fixture
def connect() -> Iterator[Connect]:
    """Give a function that starts a cloud and opens a client that may send anything."""
    opened: list[Any] = []

    def start(profile: str, secret: str | None = None, **options: Any) -> tuple[StrictCloud, Any]:
        cloud = StrictCloud(profile, **options)
        client = boto3.client(
            "ec2",
            region_name="eucalyptus",
            endpoint_url=cloud.endpoint_url,
            aws_access_key_id=cloud.access_key,
            aws_secret_access_key=secret or cloud.secret_key,
            config=Config(retries={"total_max_attempts": 1}),
        )
        opened.extend([client, cloud])
        return cloud, client

    yield start
    for thing in opened:
        thing.close()


def launch(cloud: StrictCloud, client: Any, **more: Any) -> str:
    asked = {"ImageId": cloud.image_id, "MinCount": 1, "MaxCount": 1, "InstanceType": "m5.large"}
    return str(client.run_instances(**(asked | more))["Instances"][0]["InstanceId"])


def refusal(function: Callable[..., Any], *args: Any, **kwargs: Any) -> str:
    with pytest.raises(ClientError) as caught:
        function(*args, **kwargs)
    return str(caught.value.response["Error"]["Code"])


def states(client: Any) -> list[str]:
    found = client.describe_instances()["Reservations"]
    return [instance["State"]["Name"] for r in found for instance in r["Instances"]]


TAGS = [{"ResourceType": "instance", "Tags": [{"Key": "a", "Value": "b"}]}]
SPOT = {"MarketType": "spot"}


@pytest.mark.parametrize(
    ("profile", "parameter"),
    [
        ("euca-4.0", {"TagSpecifications": TAGS}),
        ("euca-4.4", {"TagSpecifications": TAGS}),
        ("generic", {"TagSpecifications": TAGS}),
        ("euca-5.1", {"InstanceMarketOptions": SPOT}),
        ("euca-5.1", {"MetadataOptions": {"HttpTokens": "required"}}),
        ("generic", {"InstanceMarketOptions": SPOT}),
        ("euca-4.0", {"SubnetId": "subnet-1"}),
        ("euca-4.4", {"DryRun": True}),
    ],
)
def test_unknown_parameters_fail_the_call(
    connect: Connect, profile: str, parameter: dict[str, Any]
) -> None:
    cloud, client = connect(profile)
    assert refusal(launch, cloud, client, **parameter) == "InvalidParameterValue"
    assert not cloud.instances


def test_tags_at_creation_are_known_from_5_0_on(connect: Connect) -> None:
    cloud, client = connect("euca-5.0")
    launch(cloud, client, TagSpecifications=TAGS)
    assert cloud.instances[0].tags == {"a": "b"}


def test_unknown_calls_are_refused_and_stubs_are_silent(connect: Connect) -> None:
    _, client = connect("euca-5.1")
    assert refusal(client.describe_launch_templates) == "InvalidAction"
    assert client.describe_spot_instance_requests().get("SpotInstanceRequests") in (None, [])


def test_vpcs_exist_where_they_exist(connect: Connect) -> None:
    _, classic = connect("euca-4.4")
    assert refusal(classic.describe_subnets) == "InvalidAction"
    _, vpc = connect("euca-4.4", vpc=True)
    assert vpc.describe_subnets()["Subnets"]


def test_a_token_launches_once(connect: Connect) -> None:
    cloud, client = connect("aws")
    first = launch(cloud, client, ClientToken="t")
    assert launch(cloud, client, ClientToken="t") == first
    mismatch = refusal(launch, cloud, client, ClientToken="t", InstanceType="m5.xlarge")
    assert mismatch == "IdempotentParameterMismatch"
    assert len(cloud.instances) == 1


def test_states_go_on_by_descriptions(connect: Connect) -> None:
    cloud, client = connect("aws", pending=1, lag=0)
    instance = launch(cloud, client)
    assert [states(client), states(client)] == [["pending"], ["running"]]
    client.terminate_instances(InstanceIds=[instance])
    assert [states(client), states(client)] == [["shutting-down"], ["terminated"]]


def test_a_new_instance_is_not_found_at_once(connect: Connect) -> None:
    cloud, client = connect("aws", lag=1, list_lag=1)
    instance = launch(cloud, client)
    assert states(client) == []
    assert refusal(client.describe_instances, InstanceIds=[instance]) == (
        "InvalidInstanceID.NotFound"
    )
    assert states(client) == ["pending"]
    client.create_tags(Resources=[instance], Tags=[{"Key": "a", "Value": "b"}])


@pytest.mark.parametrize(
    ("profile", "code"), [("aws", "DependencyViolation"), ("euca-4.0", "InvalidGroup.InUse")]
)
def test_a_group_in_use_stays(connect: Connect, profile: str, code: str) -> None:
    cloud, client = connect(profile, pending=None, lag=0)
    group = client.create_security_group(GroupName="g", Description="d")["GroupId"]
    instance = launch(cloud, client, SecurityGroupIds=[group])
    assert refusal(client.delete_security_group, GroupId=group) == code
    client.terminate_instances(InstanceIds=[instance])
    client.delete_security_group(GroupId=group)
    assert not cloud.left()


def test_user_data_is_limited_to_16_kib(connect: Connect) -> None:
    cloud, client = connect("aws")
    assert refusal(launch, cloud, client, UserData="x" * 16385) == "InvalidParameterValue"
    launch(cloud, client, UserData="x" * 16384)
    assert cloud.instances[0].user_data == b"x" * 16384


def test_errors_are_injected_as_often_as_asked(connect: Connect) -> None:
    cloud, client = connect("aws")
    cloud.fail("DescribeRegions", "RequestLimitExceeded", 503)
    assert refusal(client.describe_regions) == "RequestLimitExceeded"
    client.describe_regions()
    cloud.fail(
        "RunInstances",
        "InsufficientInstanceCapacity",
        500,
        match={"InstanceType": "m5.large"},
        times=FOREVER,
    )
    for _ in range(2):
        assert refusal(launch, cloud, client) == "InsufficientInstanceCapacity"
    launch(cloud, client, InstanceType="m5.xlarge")
    assert len(cloud.living) == 1


def test_a_lost_answer_was_done(connect: Connect) -> None:
    cloud, client = connect("aws")
    cloud.lose("RunInstances")
    with pytest.raises(ConnectionClosedError):
        launch(cloud, client, ClientToken="t")
    launch(cloud, client, ClientToken="t")
    assert len(cloud.instances) == 1


def test_a_hook_sees_each_call_and_may_cut_it(connect: Connect) -> None:
    cloud, client = connect("aws")
    seen = []

    def hook(call: Call, moment: str) -> None:
        seen.append((call.action, moment, call.changes))
        if call.action == "RunInstances":
            raise CutError("never arrived")

    cloud.hook = hook
    client.describe_regions()
    with pytest.raises(ConnectionClosedError):
        launch(cloud, client)
    assert seen == [
        ("DescribeRegions", "before", False),
        ("DescribeRegions", "after", False),
        ("RunInstances", "before", True),
    ]
    assert not cloud.instances


def test_wrong_keys_and_missing_rights_are_refused(connect: Connect) -> None:
    _, client = connect("aws", secret="another")  # noqa: S106
    assert refusal(client.describe_regions) == "SignatureDoesNotMatch"
    cloud, client = connect("aws")
    cloud.no_rights = {"DescribeRegions"}
    assert refusal(client.describe_regions) == "UnauthorizedOperation"


def test_only_the_clouds_own_path_answers(connect: Connect) -> None:
    cloud, _ = connect("euca-5.1")
    assert cloud.endpoint_url.endswith("/services/compute/")
    client = boto3.client(
        "ec2",
        region_name="eucalyptus",
        endpoint_url=cloud.endpoint_url.replace("/services/compute", ""),
        aws_access_key_id=cloud.access_key,
        aws_secret_access_key=cloud.secret_key,
    )
    assert refusal(client.describe_regions) == "InvalidAction"
    client.close()


def test_a_eucalyptus_imports_rsa_keys_of_three_sizes(connect: Connect) -> None:
    _, client = connect("euca-5.1")
    ed25519 = b"ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIHWkn4xXnVnDgnPSSTyTQCHvL+vJlCnQQjnUcgwYBVdC"
    for key in (ed25519, rsa_key(3072)):
        code = refusal(client.import_key_pair, KeyName="k", PublicKeyMaterial=key)
        assert code == "InvalidKey.Format"
    client.import_key_pair(KeyName="k", PublicKeyMaterial=rsa_key(2048))


def test_a_eucalyptus_adds_no_rule_where_one_exists(connect: Connect) -> None:
    cloud, client = connect("euca-5.1")
    group = client.create_security_group(GroupName="g", Description="d")["GroupId"]

    def allow(*networks: str) -> None:
        ranges = [{"CidrIp": network} for network in networks]
        rule = {"IpProtocol": "tcp", "FromPort": 22, "ToPort": 22, "IpRanges": ranges}
        client.authorize_security_group_ingress(GroupId=group, IpPermissions=[rule])

    allow("192.0.2.0/24")
    allow("192.0.2.0/24", "198.51.100.0/24")
    assert len(cloud.groups[0].ingress_rules) == 1


def test_a_guest_that_shuts_down_ends_on_amazon_only(connect: Connect) -> None:
    for profile, state in (("aws", "terminated"), ("euca-4.0", "stopped")):
        cloud, client = connect(profile)
        launch(cloud, client, InstanceInitiatedShutdownBehavior="terminate")
        cloud.instances[0].shut_down()
        assert cloud.instances[0].state == state


def test_an_owner_places_an_instance_and_writes_its_console(connect: Connect) -> None:
    cloud, client = connect("aws", pending=None, lag=0)
    ended = []
    cloud.on_launch = lambda instance: instance.place("127.0.0.5", "127.0.0.6")
    cloud.on_terminate = lambda instance: ended.append(instance.id)
    instance = launch(cloud, client)
    assert states(client) == states(client) == ["pending"]
    cloud.instances[0].boot()
    cloud.instances[0].console = "hello"
    seen = client.describe_instances()["Reservations"][0]["Instances"][0]
    assert (seen["PrivateIpAddress"], seen["PublicIpAddress"]) == ("127.0.0.5", "127.0.0.6")
    assert client.get_console_output(InstanceId=instance)["Output"] == "hello"
    client.terminate_instances(InstanceIds=[instance])
    assert ended == [instance]
