"""Who may reach machines: the key pair and the security group of a cluster."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable, Mapping
from typing import Protocol

from hpccomponent.errors import CloudError
from hpcdeploy.provider import Observed, Prerequisites, Principal, Resource, Step
from hpcdeploy.providers.ec2.capabilities import Capabilities
from hpcdeploy.providers.ec2.client import Calls, Parameters
from hpcdeploy.providers.ec2.errors import code_of
from hpcdeploy.providers.ec2.names import CLUSTER_TAG, OWNER_TAG, PREFIX, group_name, key_pair_name
from hpcdeploy.providers.ec2.observe import (
    GroupSeen,
    KeyPairSeen,
    Rule,
    group_description,
    ingress_rules,
    read_group,
    read_key_pair,
)
from hpcdeploy.spec.names import Owner

_IN_USE = {"DependencyViolation", "InvalidGroup.InUse"}
_NO_GROUP = {"InvalidGroup.NotFound", "InvalidGroupId.NotFound"}


class AccessCalls(Protocol):
    """What makes a cluster's security group and key pair."""

    def create_group(self, cluster: str, incarnation: str, owner: Owner) -> GroupSeen:
        """Make the group, without rules; or return the one there is."""
        ...

    def allow(
        self, group: GroupSeen, ssh_from: frozenset[str], internal_ports: frozenset[int]
    ) -> None:
        """Make these the rules of a group: add what is missing, revoke what is too much."""
        ...

    def create_key_pair(self, cluster: str, incarnation: str, public_key: str) -> KeyPairSeen:
        """Make the key pair of a cluster's life known, or return the one there is."""
        ...


def plan_access(cloud: AccessCalls, wanted: Prerequisites, observed: Observed) -> list[Step]:
    """Return what of group, rules and key pair is missing, in the order in which it is made."""
    plan = _AccessPlan(cloud, wanted, observed)
    group, steps = plan.group, []
    if group is None:
        begins, what = wanted.incarnation, "create the security group"
        steps.append(Step("CreateGroup", what, plan.create_group, begins, makes=True))
    if group is None or (group.ssh_from, group.internal_ports) != (
        wanted.ssh_from,
        wanted.internal_ports,
    ):
        ports = ", ".join(str(port) for port in sorted(wanted.internal_ports))
        networks = ", ".join(sorted(wanted.ssh_from))
        what = f"allow SSH from {networks}, port {ports} inside"
        steps.append(Step("Allow", what, plan.allow))
    life = (wanted.cluster, wanted.incarnation)
    pairs = (r for r in observed.resources if isinstance(r, KeyPairSeen))
    if all((pair.cluster, pair.incarnation) != life for pair in pairs):
        steps.append(Step("CreateKeyPair", "create the key pair", plan.create_key_pair, makes=True))
    return steps


class _AccessPlan:
    """The group that the steps are about: the one there was, or what the first of them makes."""

    def __init__(self, cloud: AccessCalls, wanted: Prerequisites, observed: Observed) -> None:
        self._cloud, self._wanted = cloud, wanted
        groups = (r for r in observed.resources if isinstance(r, GroupSeen))
        self.group = next((group for group in groups if group.cluster == wanted.cluster), None)

    def _made(self, principal: Principal) -> GroupSeen:
        if self.group is None:
            cluster, life = self._wanted.cluster, self._wanted.incarnation
            self.group = self._cloud.create_group(cluster, life, principal.owner())
        return self.group

    def create_group(self, principal: Principal) -> str:
        return self._made(principal).incarnation

    def allow(self, principal: Principal) -> str:
        group = self._made(principal)
        self._cloud.allow(group, self._wanted.ssh_from, self._wanted.internal_ports)
        return group.incarnation

    def create_key_pair(self, principal: Principal) -> str:
        life = self._made(principal).incarnation
        self._cloud.create_key_pair(self._wanted.cluster, life, principal.public_key())
        return life


class KeyPairs:
    """The key pairs of an account that are ours."""

    def __init__(self, calls: Calls, capabilities: Capabilities) -> None:
        self._calls = calls
        self._by_tag = capabilities.tags_on_access

    def find(self, cluster: str | None, groups: Iterable[GroupSeen]) -> list[KeyPairSeen]:
        """Return those of a cluster, or of every one where None.

        `groups` are ours: where a cloud has no tags for key pairs, theirs alone are ours.
        """
        clusters = {key_pair_name(g.cluster, g.incarnation): g.cluster for g in groups}
        described = self._calls.call(
            "describe_key_pairs",
            "list the key pairs",
            Filters=[{"Name": "key-name", "Values": [f"{PREFIX}{cluster or ''}*"]}],
        )["KeyPairs"]
        seen = (
            read_key_pair(pair, None if self._by_tag else clusters.get(pair["KeyName"], ""))
            for pair in described
        )
        return [pair for pair in seen if pair is not None and cluster in (None, pair.cluster)]

    def create(self, cluster: str, incarnation: str, public_key: str) -> KeyPairSeen:
        """Import a public key; a pair of this name is from an earlier try of the same life.

        What is returned has no fingerprint.
        """
        name = key_pair_name(cluster, incarnation)
        parameters: Parameters = {"KeyName": name, "PublicKeyMaterial": public_key.encode()}
        if self._by_tag:
            tags = {CLUSTER_TAG: cluster}
            parameters["TagSpecifications"] = _specification("key-pair", tags)
        try:
            self._calls.call("import_key_pair", f"import key pair {name}", **parameters)
        except CloudError as error:
            if code_of(error) != "InvalidKeyPair.Duplicate":
                raise
        return KeyPairSeen(cluster, name, incarnation)

    def delete(self, key_pair: Resource) -> None:
        """Delete one; one that is gone is no error."""
        try:
            self._calls.call(
                "delete_key_pair", f"delete key pair {key_pair.name}", KeyName=key_pair.name
            )
        except CloudError as error:
            if code_of(error) != "InvalidKeyPair.NotFound":
                raise


class SecurityGroups:
    """The security groups of an account that are ours, and their rules.

    A group is made in `subnets`, ids of subnets of one VPC; in the default without any.
    """

    def __init__(
        self, calls: Calls, capabilities: Capabilities, ssh_port: int, subnets: tuple[str, ...]
    ) -> None:
        self._calls = calls
        self._knows = capabilities
        self._ssh_port = ssh_port
        self._subnets = subnets

    def find(self, name: str) -> list[GroupSeen]:
        """Return those of a name, which may hold ``*``."""
        described = self._calls.all_of(
            "describe_security_groups",
            "SecurityGroups",
            "list the security groups",
            Filters=[{"Name": "group-name", "Values": [name]}],
        )
        seen = (read_group(group, self._ssh_port) for group in described)
        return [group for group in seen if group is not None]

    def create(self, cluster: str, incarnation: str, owner: Owner) -> GroupSeen:
        """Make a group without rules, or return the one that is there.

        The description of a new one has the incarnation; where tags cannot be set at once its owner
        is empty. Raises CloudError where one of this name is not hpcapp's, or the cloud refuses.
        """
        name = group_name(cluster)
        parameters: Parameters = {
            "GroupName": name,
            "Description": group_description(cluster, incarnation),
        }
        if self._knows.tags_on_access:
            tags = {CLUSTER_TAG: cluster, OWNER_TAG: str(owner)}
            parameters["TagSpecifications"] = _specification("security-group", tags)
        if self._subnets:
            parameters["VpcId"] = self._vpc()
        try:
            reply = self._calls.call(
                "create_security_group", f"create security group {name}", **parameters
            )
        except CloudError as error:
            if code_of(error) != "InvalidGroup.Duplicate":
                raise
            for group in self.find(name):
                return group
            raise CloudError(
                f"a security group {name} exists and is not hpcapp's",
                "give the cluster another name, or delete the group",
            ) from error
        known = owner if self._knows.tags_on_access else Owner()
        return GroupSeen(cluster, name, incarnation, reply["GroupId"], known)

    def _vpc(self) -> str:
        subnet = self._subnets[0]
        reply = self._calls.call("describe_subnets", f"find subnet {subnet}", SubnetIds=[subnet])
        return str(reply["Subnets"][0]["VpcId"])

    def allow(
        self, group: GroupSeen, ssh_from: frozenset[str], internal_ports: frozenset[int]
    ) -> None:
        """Make these the ways in; the ways out stay as they are."""
        described = self._calls.call(
            "describe_security_groups",
            f"read security group {group.name}",
            not_yet=_NO_GROUP,
            GroupIds=[group.id],
        )["SecurityGroups"][0]
        # A classic network may name a group where others give its id.
        now = {
            (*rule[:4], group.id if rule[4] == group.name else rule[4])
            for rule in ingress_rules(described)
        }
        port = self._ssh_port
        wanted: set[Rule] = {
            ("tcp", port, port, "cidr", str(ipaddress.ip_network(cidr, strict=False)))
            for cidr in ssh_from
        }
        wanted |= {("tcp", port, port, "group", group.id) for port in internal_ports}
        # One rule a call: a Eucalyptus adds none of several where it has one of them already.
        for rule in sorted(wanted - now):
            self._change("authorize", group, rule, is_done={"InvalidPermission.Duplicate"})
        for rule in sorted(now - wanted):
            self._change("revoke", group, rule, is_done={"InvalidPermission.NotFound"})

    def _change(self, verb: str, group: GroupSeen, rule: Rule, is_done: set[str]) -> None:
        source = f"{rule[4]} to {rule[0]} {rule[1]}"
        if ":" in rule[4] and not self._knows.ipv6:
            raise CloudError(
                f"security group {group.name}: this cloud knows no IPv6 network {rule[4]}",
                "name IPv4 networks in auth.allow_from",
            )
        try:
            self._calls.call(
                f"{verb}_security_group_ingress",
                f"{verb} {source} in security group {group.name}",
                not_yet=_NO_GROUP,
                GroupId=group.id,
                IpPermissions=[_permission(rule)],
            )
        except CloudError as error:
            if code_of(error) not in is_done:
                raise

    def delete(self, group: Resource) -> bool:
        """Delete a group; False while it is in use."""
        try:
            self._calls.call(
                "delete_security_group", f"delete security group {group.name}", GroupId=group.id
            )
        except CloudError as error:
            if code_of(error) in _IN_USE:
                return False
            if code_of(error) not in _NO_GROUP:
                raise
        return True


def _specification(kind: str, tags: Mapping[str, str]) -> list[dict[str, object]]:
    # What the cloud's keys may change can so be bound to the tag: see
    # docs/how-to/describe-a-cluster.md.
    pairs = [{"Key": key, "Value": value} for key, value in tags.items()]
    return [{"ResourceType": kind, "Tags": pairs}]


def _permission(rule: Rule) -> dict[str, object]:
    protocol, first, last, kind, source = rule
    permission: dict[str, object] = {"IpProtocol": protocol}
    if protocol != "-1":
        permission |= {"FromPort": first, "ToPort": last}
    if kind == "group":
        return permission | {"UserIdGroupPairs": [{"GroupId": source}]}
    if kind == "prefix_list":
        return permission | {"PrefixListIds": [{"PrefixListId": source}]}
    if ":" in source:
        return permission | {"Ipv6Ranges": [{"CidrIpv6": source}]}
    return permission | {"IpRanges": [{"CidrIp": source}]}
