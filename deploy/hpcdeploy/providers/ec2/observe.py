"""What a cloud describes, read as machines, groups and key pairs of ours.

Ours is what bears our tags; or, where a cloud cannot tag at launch, a machine in a group with a
name of ours whose client token is one of ours. A group is ours by its description, whatever its
name; where a cloud cannot tag key pairs, one is ours that is named after the life of such a group.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import ClassVar

from hpccomponent.dataclass import dataclass
from hpcdeploy.provider import MachineSeen, Resource, State
from hpcdeploy.providers.ec2.client import Described
from hpcdeploy.providers.ec2.names import (
    CLUSTER_TAG,
    GENERATION_TAG,
    INCARNATION_TAG,
    LEASE_TAG,
    MADE_TAG,
    NODE_TAG,
    OWNER_TAG,
    PREFIX,
    SET_UP_TAG,
    WORKERS_TAG,
    key_pair_name,
    read_client_token,
)
from hpcdeploy.spec.names import NodeName, read_desired, read_owner

Rule = tuple[str, int, int, str, str]
"""Protocol, first and last port (-1: all), kind of source ("cidr", ...) and the source."""

_STATES = {
    "pending": State.PENDING,
    "running": State.RUNNING,
    "stopping": State.STOPPED,
    "stopped": State.STOPPED,
    "shutting-down": State.ENDING,
    "terminated": State.GONE,
}
_DESCRIPTION = re.compile(r"hpcapp cluster ([a-z][a-z0-9-]*) life ([0-9a-z]+)")


@dataclass(frozen=True, slots=True)
class GroupSeen(Resource):
    """A security group of ours; its description holds the incarnation.

    Networks (CIDR) in `ssh_from` reach the SSH port, and the group's machines the `internal_ports`
    of one another.
    """

    ssh_from: frozenset[str] = frozenset()
    internal_ports: frozenset[int] = frozenset()

    kind: ClassVar[str] = "security group"
    bears_life: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class KeyPairSeen(Resource):
    """A key pair of ours."""

    kind: ClassVar[str] = "key pair"


def group_description(cluster: str, incarnation: str) -> str:
    """Return the text by which a group is known as ours, and its incarnation remembered."""
    return f"hpcapp cluster {cluster} life {incarnation}"


def lease_text(lease_until: datetime) -> str:
    """Return the end of a lease as its tag says it."""
    return lease_until.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def identity_tags(cluster: str, incarnation: str, name: NodeName) -> dict[str, str]:
    """Return the tags that say which machine one is."""
    return {
        "Name": f"{PREFIX}{cluster}-{name.node}",
        CLUSTER_TAG: cluster,
        NODE_TAG: name.node,
        GENERATION_TAG: str(name.generation),
        INCARNATION_TAG: incarnation,
    }


def read_machine(described: Described) -> MachineSeen | None:
    """Return an instance as a machine of ours, or None where it is none."""
    known = _known_by_tags(_tags(described)) or _known_by_token(described)
    return None if known is None else as_machine(described, *known)


def as_machine(described: Described, cluster: str, incarnation: str, name: NodeName) -> MachineSeen:
    """Return an instance as the machine that it is known to be."""
    reason = described.get("StateReason", {}).get("Message")
    tags = _tags(described)
    return MachineSeen(
        id=described["InstanceId"],
        cluster=cluster,
        name=name,
        incarnation=incarnation,
        state=_STATES.get(described["State"]["Name"], State.PENDING),
        public_address=described.get("PublicIpAddress", ""),
        private_address=described.get("PrivateIpAddress", ""),
        instance_type=described.get("InstanceType", ""),
        market="spot" if described.get("InstanceLifecycle") == "spot" else "on_demand",
        zone=described.get("Placement", {}).get("AvailabilityZone", ""),
        launched=described.get("LaunchTime"),
        lease_until=_read_lease(tags.get(LEASE_TAG, "")),
        reason=reason or described.get("StateTransitionReason", ""),
        owner=read_owner(tags.get(OWNER_TAG, "")),
        desired=read_desired(tags.get(WORKERS_TAG, "")),
        image=described.get("ImageId", ""),
        subnet=described.get("SubnetId", ""),
        made_as=tags.get(MADE_TAG, ""),
        set_up_by=tags.get(SET_UP_TAG, ""),
    )


def _tags(described: Described) -> dict[str, str]:
    return {tag["Key"]: tag["Value"] for tag in described.get("Tags", [])}


def _known_by_tags(tags: Mapping[str, str]) -> tuple[str, str, NodeName] | None:
    generation = tags.get(GENERATION_TAG, "")
    if not (tags.get(CLUSTER_TAG) and tags.get(NODE_TAG) and generation.isdecimal()):
        return None
    name = NodeName(tags[NODE_TAG], int(generation))
    return tags[CLUSTER_TAG], tags.get(INCARNATION_TAG, ""), name


def _known_by_token(described: Described) -> tuple[str, str, NodeName] | None:
    known = read_client_token(described.get("ClientToken", ""))
    for group in described.get("SecurityGroups", []):
        if known is not None and group.get("GroupName", "").startswith(PREFIX):
            return group["GroupName"].removeprefix(PREFIX), *known
    return None


def _read_lease(text: str) -> datetime | None:
    try:
        return datetime.strptime(text, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
    except ValueError:  # never written, or not by us
        return None


def read_group(described: Described, ssh_port: int) -> GroupSeen | None:
    """Return a security group as one of ours, or None where it is none.

    Its `ssh_from` are the networks that reach `ssh_port`.
    """
    match = _DESCRIPTION.fullmatch(described.get("Description", ""))
    if match is None or described["GroupName"] != PREFIX + match[1]:
        return None
    rules = ingress_rules(described)
    own_names = {described["GroupId"], described["GroupName"]}
    return GroupSeen(
        cluster=match[1],
        id=described["GroupId"],
        name=described["GroupName"],
        incarnation=match[2],
        ssh_from=frozenset(
            source
            for protocol, first, last, kind, source in rules
            if (protocol, first, last, kind) == ("tcp", ssh_port, ssh_port, "cidr")
        ),
        internal_ports=frozenset(
            first
            for protocol, first, last, kind, source in rules
            if (protocol, kind) == ("tcp", "group") and first == last and source in own_names
        ),
        owner=read_owner(_tags(described).get(OWNER_TAG, "")),
    )


def ingress_rules(described: Described) -> set[Rule]:
    """Return the rules of a group, one for each source.

    Each is protocol, first and last port, kind (``cidr``, ``group``, ``prefix_list``) and source.
    """
    rules = set()
    for permission in described.get("IpPermissions", []):
        ports = (
            str(permission.get("IpProtocol", "-1")),
            int(permission.get("FromPort", -1)),
            int(permission.get("ToPort", -1)),
        )
        for ipv4 in permission.get("IpRanges", []):
            rules.add((*ports, "cidr", str(ipv4["CidrIp"])))
        for ipv6 in permission.get("Ipv6Ranges", []):
            rules.add((*ports, "cidr", str(ipv6["CidrIpv6"])))
        for pair in permission.get("UserIdGroupPairs", []):
            rules.add((*ports, "group", str(pair.get("GroupId") or pair["GroupName"])))
        for prefix_list in permission.get("PrefixListIds", []):
            rules.add((*ports, "prefix_list", str(prefix_list["PrefixListId"])))
    return rules


def read_key_pair(described: Described, cluster: str | None) -> KeyPairSeen | None:
    """Return a key pair as one of ours, or None where it is none.

    `cluster` is whose it is by its name, empty where nobody's; None where its tags tell.
    """
    name = str(described["KeyName"])
    if cluster is None:
        cluster = _tags(described).get(CLUSTER_TAG, "")
    incarnation = name.removeprefix(key_pair_name(cluster, ""))
    if not cluster or incarnation == name:
        return None
    return KeyPairSeen(
        cluster, name, incarnation, fingerprint=str(described.get("KeyFingerprint", ""))
    )
