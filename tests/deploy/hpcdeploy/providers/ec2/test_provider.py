"""One contract for all clouds: what the provider does on each of them, and what it never sends."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest
from cloud import FOREVER, RSA_KEY, Call, CutError, StrictCloud
from cloud.parameters import PROFILES
from simulated import groups_of, key_pairs_of

from hpccomponent.errors import CapacityError, CloudError
from hpcdeploy.provider import Observed, State, Tags
from hpcdeploy.spec.names import NOBODY, Desired, NodeName

from .conftest import LEASE, OPEN, OWNER, Desk, a_launch

OpenDesk = Callable[..., Desk]
every_cloud = pytest.mark.parametrize("profile", PROFILES)
each_kind = pytest.mark.parametrize("profile", ["aws", "euca-4.0", "euca-5.1", "generic"])


@pytest.mark.slow
@every_cloud
def test_a_life_leaves_nothing(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, lag=2, list_lag=1)
    desk.prepare()
    launched = desk.launch()
    assert launched.state is State.PENDING
    assert desk.provider.observe("bunny").machines == ()  # a list lags
    (seen,) = desk.provider.observe("bunny").machines
    assert (seen.id, seen.name, seen.incarnation) == (launched.id, NodeName("worker-1"), "a1b2c3")
    assert (seen.lease_until, seen.cluster) == (LEASE, "bunny")
    (running,) = desk.provider.observe("bunny").machines
    assert running.state is State.RUNNING
    assert running.public_address
    assert running.private_address
    observed = desk.provider.observe(None)
    (group,) = groups_of(observed)
    assert (group.incarnation, group.ssh_from) == ("a1b2c3", OPEN)
    assert group.internal_ports == {7070}
    desk.provider.terminate([running])
    assert not desk.provider.cleanup(group)
    while desk.provider.observe("bunny").machines[0].state is not State.GONE:
        pass
    assert desk.provider.cleanup(group)
    desk.provider.cleanup(key_pairs_of(observed)[0])
    assert not desk.cloud.left()


@every_cloud
def test_an_instance_carries_what_it_is(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    desk.prepare()
    desk.launch("head")
    (instance,) = desk.cloud.instances
    tags = instance.tags
    assert {
        "hpcapp:cluster": "bunny",
        "hpcapp:node": "head",
        "project": "x",
    }.items() <= tags.items()
    assert tags["hpcapp:lease-until"] == "2030-01-02T03:04:05Z"
    assert instance.user_data == b"#!/bin/sh\n"
    assert instance.public_key.split()[:2] == RSA_KEY.split()
    assert instance.groups == ["hpcapp-bunny"]


@each_kind
def test_a_launch_asked_twice_starts_one(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    desk.prepare()
    first = desk.launch()
    assert desk.launch().id == first.id
    later = LEASE + timedelta(hours=1)
    again = desk.launch(lease_until=later, user_data="#!/bin/sh\n# another lease\n")
    assert again.id == first.id
    assert desk.provider.observe("bunny").machines[0].lease_until == later
    assert len(desk.cloud.instances) == 1


def test_a_launch_asked_twice_is_found_in_lists_that_lag(open_desk: OpenDesk) -> None:
    desk = open_desk("aws", list_lag=2)
    desk.prepare()
    first = desk.launch()
    assert desk.launch(user_data="#!/bin/sh\n# another\n").id == first.id
    assert len(desk.waits) == 3  # two for the lists, one for the tags


@pytest.mark.parametrize("profile", ["aws", "euca-4.0"])
def test_a_token_whose_machine_is_gone_gives_no_other(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    desk.prepare()
    first = desk.launch()
    desk.cloud.instances[0].die()
    desk.cloud.no_rights = {"CreateTags"}  # nothing is tagged any more
    for user_data in ("#!/bin/sh\n", "#!/bin/sh\n# another\n"):
        again = desk.launch(user_data=user_data)
        assert (again.id, again.state) == (first.id, State.GONE)


def test_machines_are_launched_at_once(open_desk: OpenDesk) -> None:
    desk = open_desk("euca-4.0")
    desk.prepare()
    with ThreadPoolExecutor(8) as pool:
        launched = list(pool.map(desk.launch, [f"worker-{n}" for n in range(1, 9)]))
    seen = desk.provider.observe("bunny").machines
    assert {(m.id, m.name) for m in seen} == {(m.id, m.name) for m in launched}


@each_kind
def test_a_lost_answer_starts_one(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    desk.prepare()
    desk.cloud.lose("RunInstances", times=2)
    launched = desk.launch()
    assert [instance.id for instance in desk.cloud.instances] == [launched.id]
    assert len(desk.waits) >= 2


@pytest.mark.parametrize("action", ["CreateSecurityGroup", "ImportKeyPair"])
@each_kind
def test_lost_answers_are_asked_for_again(open_desk: OpenDesk, profile: str, action: str) -> None:
    desk = open_desk(profile)
    for lost in (action, "AuthorizeSecurityGroupIngress"):
        desk.cloud.lose(lost)
    desk.prepare()
    observed = desk.provider.observe("bunny")
    assert (len(observed.lives), len(key_pairs_of(observed))) == (1, 1)
    assert (groups_of(observed)[0].ssh_from, groups_of(observed)[0].internal_ports) == (
        OPEN,
        frozenset({7070}),
    )
    for lost in ("DeleteSecurityGroup", "DeleteKeyPair"):
        desk.cloud.lose(lost)
    assert desk.provider.cleanup(observed.lives[0])
    desk.provider.cleanup(key_pairs_of(observed)[0])
    assert not desk.cloud.left()


@pytest.mark.parametrize("profile", ["euca-4.0", "euca-4.4", "generic"])
@pytest.mark.parametrize("cluster", ["bunny", "a-cluster-with-a-name-of-forty-characters"])
def test_a_machine_whose_tags_were_never_written_is_known(
    open_desk: OpenDesk, profile: str, cluster: str
) -> None:
    desk = open_desk(profile)
    desk.provider.create_key_pair(cluster, "a1b2c3", RSA_KEY)
    desk.provider.create_group(cluster, "a1b2c3", NOBODY)
    desk.cloud.no_rights = {"CreateTags"}
    with pytest.raises(CloudError, match="ec2:CreateTags"):
        desk.provider.launch(replace(a_launch("worker-12"), cluster=cluster))
    assert desk.cloud.instances[0].tags == {}
    (seen,) = desk.provider.observe(None).machines
    assert (seen.cluster, seen.incarnation) == (cluster, "a1b2c3")
    assert (seen.name, seen.lease_until) == (NodeName("worker-12"), None)
    desk.cloud.no_rights = set()
    desk.provider.tag([seen], Tags(lease_until=LEASE))
    assert desk.cloud.instances[0].tags["hpcapp:node"] == "worker-12"
    assert desk.provider.observe(cluster).machines[0].lease_until == LEASE


@each_kind
def test_a_lease_is_extended(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, lag=0)
    desk.prepare()
    for node in ("head", "worker-1"):
        desk.launch(node)
    later = LEASE + timedelta(hours=1)
    before = len(desk.changes())
    desk.provider.tag(desk.provider.observe("bunny").machines, Tags(lease_until=later))
    assert desk.changes()[before:] == ["CreateTags"]
    assert {m.lease_until for m in desk.provider.observe("bunny").machines} == {later}


@each_kind
def test_the_head_bears_how_many_workers_are_wanted(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, lag=2)
    desk.prepare()
    head = desk.launch("head", desired=Desired(1, 3))
    desk.launch("worker-1")
    assert desk.provider.observe("bunny").desired("bunny") == Desired(1, 3)
    desk.provider.tag([head], Tags(desired=Desired(2, 1)))
    assert desk.provider.observe(None).desired("bunny") == Desired(2, 1)
    assert desk.provider.observe(None).desired("other") is None


@each_kind
def test_a_machine_tells_who_sets_it_up_beside_who_launched_it(
    open_desk: OpenDesk, profile: str
) -> None:
    desk = open_desk(profile, lag=2)
    desk.prepare()
    head = desk.launch("head")
    assert head.set_up_by == ""
    desk.provider.tag([head], Tags(set_up_by="clara@lab"))
    (seen,) = desk.provider.observe("bunny").machines
    assert (seen.set_up_by, seen.owner) == ("clara@lab", head.owner)


@each_kind
def test_a_machine_tells_by_what_it_was_launched(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, lag=0, vpc=True)
    desk.prepare()
    desk.launch(made_as="disk_gb=20 public_ip=None")
    (seen,) = desk.provider.observe("bunny").machines
    assert seen.made_as == "disk_gb=20 public_ip=None"
    assert seen.image == desk.cloud.image_id
    assert seen.subnet.startswith("subnet-")


def test_clusters_do_not_see_one_another(open_desk: OpenDesk) -> None:
    for profile in ("aws", "euca-4.0"):
        desk = open_desk(profile)
        for cluster in ("bunny", "bunny-2"):
            desk.provider.create_key_pair(cluster, "a1b2c3", RSA_KEY)
            desk.provider.create_group(cluster, "a1b2c3", NOBODY)
            desk.provider.launch(replace(a_launch(), cluster=cluster))
        observed = desk.provider.observe("bunny")
        assert {m.cluster for m in observed.machines} == {"bunny"}
        assert [group.cluster for group in observed.lives] == ["bunny"]
        assert [pair.cluster for pair in key_pairs_of(observed)] == ["bunny"]
        everything = desk.provider.observe(None)
        assert {m.cluster for m in everything.machines} == {"bunny", "bunny-2"}


@pytest.mark.parametrize(
    "code",
    ["InsufficientInstanceCapacity", "InstanceLimitExceeded", "InsufficientFreeAddressesInSubnet"],
)
@each_kind
def test_what_is_sold_out_is_said_at_once(open_desk: OpenDesk, profile: str, code: str) -> None:
    desk = open_desk(profile)
    desk.prepare()
    desk.cloud.fail("RunInstances", code, 500, match={"InstanceType": "m5.large"}, times=FOREVER)
    with pytest.raises(CapacityError, match=f"worker-1 .m5.large, on_demand.*{code}"):
        desk.launch()
    assert desk.changes().count("RunInstances") == 1
    assert desk.waits == []
    desk.launch(instance_type="m5.xlarge")
    assert [instance.type for instance in desk.cloud.living] == ["m5.xlarge"]


def test_throttling_is_waited_out_within_bounds(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    desk.cloud.fail("*", "RequestLimitExceeded", 503, times=3)
    desk.provider.observe("bunny")
    assert len(desk.waits) == 3
    assert desk.waits == sorted(desk.waits)
    desk.cloud.fail("*", "Throttling", 400, times=FOREVER)
    with pytest.raises(CloudError, match="fewer calls"):
        desk.provider.observe("bunny")
    assert sum(desk.waits) < 20


def test_a_launch_waits_until_its_group_is_known(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    desk.prepare()
    desk.cloud.fail("RunInstances", "InvalidGroup.NotFound")
    desk.launch()
    assert len(desk.waits) == 1


def test_a_launch_without_its_group_is_refused(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    with pytest.raises(CloudError, match="hpcapp-bunny is gone"):
        desk.launch()
    assert not desk.cloud.instances


@each_kind
def test_what_others_made_is_never_touched(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    backend = desk.cloud.model.backend
    backend.create_security_group("hpcapp-bunny", "somebody's own", vpc_id=None)
    for name in ("hpcapp-bunny", "hpcapp-bunny-a1b2c3"):
        backend.import_key_pair(name, RSA_KEY.encode(), {})
    with pytest.raises(CloudError, match="security group hpcapp-bunny exists and is not"):
        desk.provider.create_group("bunny", "a1b2c3", NOBODY)
    for cluster in ("bunny", None):
        assert desk.provider.observe(cluster) == Observed()


@each_kind
def test_rules_become_what_is_wanted(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    group = desk.provider.create_group("bunny", "a1b2c3", NOBODY)
    desk.provider.allow(group, frozenset({"192.0.2.0/24", "203.0.113.9/32"}), frozenset({7070}))
    (foreign,) = desk.cloud.groups
    backend = desk.cloud.model.backend
    everybody = [{"CidrIp": "0.0.0.0/0"}]
    backend.authorize_security_group_ingress(foreign.id, "tcp", "1", "65535", everybody)
    wanted = frozenset({"192.0.2.0/24", "198.51.100.0/24"})
    desk.provider.allow(group, wanted, frozenset({7071}))
    (seen,) = groups_of(desk.provider.observe("bunny"))
    assert (seen.ssh_from, seen.internal_ports) == (wanted, frozenset({7071}))
    assert len(foreign.ingress_rules) == 3
    before = len(desk.changes())
    desk.provider.allow(seen, wanted, frozenset({7071}))
    assert desk.changes()[before:] == []


def test_ipv6_networks_where_they_are_known(open_desk: OpenDesk) -> None:
    network = frozenset({"2001:db8::/32"})
    desk = open_desk("aws")
    group = desk.provider.create_group("bunny", "a1b2c3", NOBODY)
    desk.provider.allow(group, network, frozenset())
    assert groups_of(desk.provider.observe("bunny"))[0].ssh_from == network
    desk = open_desk("euca-5.1")
    group = desk.provider.create_group("bunny", "a1b2c3", NOBODY)
    with pytest.raises(CloudError, match="no IPv6 network 2001:db8::/32"):
        desk.provider.allow(group, network, frozenset())


def test_amazon_gets_what_only_amazon_knows(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    desk.prepare()
    machine = desk.launch(market="spot")
    (call,) = [call for call in desk.cloud.calls if call.action == "RunInstances"]
    assert call.parameters["InstanceInitiatedShutdownBehavior"] == "terminate"
    assert call.parameters["MetadataOptions.HttpTokens"] == "required"
    assert call.parameters["InstanceMarketOptions.SpotOptions.SpotInstanceType"] == "one-time"
    assert machine.market == "spot"
    desk.cloud.instances[0].die()
    (seen,) = desk.provider.observe("bunny").machines
    assert (seen.state, seen.market) == (State.GONE, "spot")
    assert seen.reason == "Server.SpotInstanceTermination"


def tagged(desk: Desk) -> dict[str, dict[str, str]]:
    """Return what a launch asks to be tagged, by the kind of thing."""
    (call,) = [call for call in desk.cloud.calls if call.action == "RunInstances"]
    found: dict[str, dict[str, str]] = {}
    for number in range(1, 5):
        prefix = f"TagSpecification.{number}."
        if kind := call.parameters.get(f"{prefix}ResourceType"):
            keys = {k: v for k, v in call.parameters.items() if k.startswith(f"{prefix}Tag.")}
            found[kind] = {
                v: keys[k.removesuffix("Key") + "Value"]
                for k, v in keys.items()
                if k.endswith("Key")
            }
    return found


@pytest.mark.parametrize("market", ["on_demand", "spot"])
def test_what_comes_with_a_machine_is_tagged_as_it_is(open_desk: OpenDesk, market: str) -> None:
    desk = open_desk("aws")
    desk.prepare()
    desk.launch(market=market)
    found = tagged(desk)
    spot = {"spot-instances-request"} if market == "spot" else set()
    assert found.keys() == {"instance", "volume", "network-interface"} | spot
    for tags in found.values():
        assert tags == found["instance"]
        assert {"hpcapp:cluster": "bunny", "project": "x"}.items() <= tags.items()
        assert tags["hpcapp:owner"] == str(OWNER)


def test_a_eucalyptus_is_asked_for_tags_of_machines_alone(open_desk: OpenDesk) -> None:
    desk = open_desk("euca-5.1")
    desk.prepare()
    desk.launch()
    assert tagged(desk).keys() == {"instance"}


@pytest.mark.parametrize("profile", ["euca-4.0", "euca-5.1", "generic"])
def test_no_other_cloud_is_asked_for_spot(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    desk.prepare()
    with pytest.raises(CloudError, match="no spot market"):
        desk.launch(market="spot")
    assert not desk.cloud.instances


@each_kind
def test_a_disk_is_sized_and_ends_with_its_machine(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, small={"disk_gb": 20, "zone": "us-east-1b"})
    desk.prepare()
    assert desk.launch().zone == "us-east-1b"
    (call,) = [call for call in desk.cloud.calls if call.action == "RunInstances"]
    assert call.parameters["BlockDeviceMapping.1.DeviceName"] == "/dev/xvda"
    assert call.parameters["BlockDeviceMapping.1.Ebs.VolumeSize"] == "19"  # GiB
    assert call.parameters["BlockDeviceMapping.1.Ebs.DeleteOnTermination"] == "true"


def test_a_subnet_is_used_with_a_group_of_its_vpc(open_desk: OpenDesk) -> None:
    cloud = StrictCloud("aws")
    subnet = cloud.model.default_subnet("us-east-1c")
    desk = open_desk("aws", cloud=cloud, provider={"subnet": subnet})
    desk.prepare()
    assert desk.launch().zone == "us-east-1c"


def test_user_data_over_the_limit_is_never_sent(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    desk.prepare()
    with pytest.raises(CloudError, match="16385 bytes"):
        desk.launch(user_data="x" * 16385)
    desk.launch(user_data="x" * 16384)


@each_kind
def test_one_unknown_machine_keeps_no_other_alive(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, lag=0)
    desk.prepare()
    machine = desk.launch()
    desk.provider.terminate([replace(machine, id="i-00000000000000bad"), machine])
    assert not desk.cloud.living
    desk.provider.terminate([machine])
    desk.provider.terminate([])


@each_kind
def test_the_console_is_read(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile)
    desk.prepare()
    machine = desk.launch()
    assert desk.provider.console(machine) == ""
    desk.cloud.instances[0].console = "host keys: ...\n"
    assert desk.provider.console(machine) == "host keys: ...\n"
    latest = [call.parameters.get("Latest") for call in desk.cloud.calls[-1:]]
    assert latest == (["true"] if profile == "aws" else [None])


def test_a_console_that_lags_is_read_too(open_desk: OpenDesk) -> None:
    desk = open_desk("aws", lag=0)
    desk.prepare()
    machine = desk.launch()
    desk.cloud.instances[0].console = "old\n"
    desk.cloud.fail("GetConsoleOutput", "UnsupportedOperation", match={"Latest": "true"})
    assert desk.provider.console(machine) == "old\n"


def test_a_request_that_never_arrives_ends_in_one_line(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")

    def cut(call: Call, moment: str) -> None:
        raise CutError

    desk.cloud.hook = cut
    with pytest.raises(CloudError, match=r"the cloud: cannot list .*provider\.endpoint_url"):
        desk.provider.observe("bunny")


def test_many_machines_come_in_pages(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    pages: list[Any] = [
        {"Reservations": [{"Instances": []}], "NextToken": "2"},
        {"Reservations": [{"Instances": []}]},
    ]
    asked = []

    class Client:
        def describe_instances(self, **parameters: Any) -> Any:
            asked.append(parameters.get("NextToken"))
            return pages[len(asked) - 1]

    desk.provider._calls._client = Client()
    assert desk.provider._find("tag-key", "x") == []
    assert asked == [None, "2"]


def test_what_amazons_policy_binds_to_a_tag_bears_it(open_desk: OpenDesk) -> None:
    desk = open_desk("aws")
    desk.prepare()
    desk.launch()
    for made in (*desk.cloud.groups, *desk.cloud.model.backend.key_pairs.values()):
        tags = {tag["key"]: tag["value"] for tag in made.get_tags()}
        assert tags["hpcapp:cluster"] == "bunny"
    assert desk.cloud.instances[0].tags["hpcapp:cluster"] == "bunny"


def launched_parameters(desk: Desk) -> dict[str, str]:
    (call,) = [call for call in desk.cloud.calls if call.action == "RunInstances"]
    return call.parameters


@pytest.mark.parametrize("profile", ["aws", "euca-4.1"])
@pytest.mark.parametrize("has_one", [True, False])
def test_a_machine_gets_a_public_address_or_none(
    open_desk: OpenDesk, profile: str, has_one: bool
) -> None:
    desk = open_desk(profile, small={"public_ip": has_one})
    desk.prepare()
    desk.launch()
    sent = launched_parameters(desk)
    assert sent["NetworkInterface.1.AssociatePublicIpAddress"] == str(has_one).lower()
    assert sent["NetworkInterface.1.SecurityGroupId.1"] == desk.cloud.groups[0].id
    assert "SecurityGroupId.1" not in sent


@pytest.mark.parametrize("profile", ["euca-4.0", "generic"])
def test_a_cloud_that_cannot_be_told_is_not_asked(open_desk: OpenDesk, profile: str) -> None:
    desk = open_desk(profile, small={"public_ip": False})
    desk.prepare()
    with pytest.raises(CloudError, match="cannot be told whether machines get a public address"):
        desk.launch()
    assert not desk.cloud.instances
