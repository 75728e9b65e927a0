"""Amazon EC2, Eucalyptus, and every other cloud that speaks EC2.

::

    provider ── observe   descriptions -> what is ours
       │ ────── access    key pair, security group and its rules
       │ ────── bucket    large files
       │ ────── launch    parameters of a launch
       │ ────── images    which image a profile boots
       │ ────── check     what would make `up` fail
       │          │
       │       client ── login ── key_errors
       │          └───── credentials, errors
       └────── capabilities   which cloud knows which call and parameter
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

from hpccomponent.errors import CloudError
from hpcdeploy.provider import (
    Launch,
    MachineSeen,
    Observed,
    Prerequisites,
    Problem,
    Provider,
    Resource,
    State,
    Step,
    Tags,
)
from hpcdeploy.providers.ec2.access import KeyPairs, SecurityGroups, plan_access
from hpcdeploy.providers.ec2.bucket import S3Bucket, open_bucket
from hpcdeploy.providers.ec2.capabilities import capabilities_of
from hpcdeploy.providers.ec2.check import check_cloud
from hpcdeploy.providers.ec2.client import Calls, Described, open_calls, read_parameter
from hpcdeploy.providers.ec2.errors import code_of
from hpcdeploy.providers.ec2.images import Images
from hpcdeploy.providers.ec2.launch import attempt_of, launch_parameters, launch_tags, profile_of
from hpcdeploy.providers.ec2.names import (
    CLUSTER_TAG,
    LEASE_TAG,
    OWNER_TAG,
    PREFIX,
    SET_UP_TAG,
    WORKERS_TAG,
    client_token,
    group_name,
)
from hpcdeploy.providers.ec2.observe import (
    GroupSeen,
    KeyPairSeen,
    as_machine,
    identity_tags,
    lease_text,
    read_machine,
)
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import Owner
from hpcdeploy.spec.provider import CloudSpec

_NO_INSTANCE = "InvalidInstanceID.NotFound"
_NOT_YET = {_NO_INSTANCE}
_NOT_YET_FOR_TAGS = _NOT_YET | {"InvalidGroup.NotFound", "InvalidGroupId.NotFound"}
_NOT_YET_FOR_LAUNCH = {"InvalidGroup.NotFound", "InvalidKeyPair.NotFound"}


def open_ec2(spec: ClusterSpec, base: Path) -> Ec2Provider:
    """Return the provider of a cluster on an EC2-compatible cloud."""
    cloud = cast(CloudSpec, spec.provider)
    calls = open_calls(cloud, base)
    return Ec2Provider(
        cloud,
        calls,
        spec.auth.ssh_port,
        partial(read_parameter, cloud, base),
        partial(open_bucket, spec, base),
    )


def _no_parameters(name: str) -> str:
    raise CloudError(f"there is no parameter store to find {name} in", "give the image's id")


class Ec2Provider(Provider):
    """A `Provider` over EC2's interface; safe to use from several threads.

    `allow` opens `ssh_port`; `read_parameter` returns a value of the cloud's parameter store.
    """

    makes_machines = True

    def __init__(
        self,
        cloud: CloudSpec,
        calls: Calls,
        ssh_port: int,
        read_parameter: Callable[[str], str] = _no_parameters,
        open_bucket: Callable[[], S3Bucket | None] = lambda: None,
    ) -> None:
        self._open_bucket = open_bucket
        self.name: str = cloud.type
        self._cloud = cloud
        self._calls = calls
        self._knows = capabilities_of(cloud)
        self._groups = SecurityGroups(calls, self._knows, ssh_port, cloud.subnets)
        self._key_pairs = KeyPairs(calls, self._knows)
        self._images = Images(calls, read_parameter)

    def observe(self, cluster: str | None) -> Observed:
        """Return all that exists of a cluster of ours, or of every one where None."""
        name = f"{PREFIX}*" if cluster is None else group_name(cluster)
        if not self._knows.tags_at_launch:
            condition = ("instance.group-name", name)
        elif cluster is None:
            condition = ("tag-key", CLUSTER_TAG)
        else:
            condition = (f"tag:{CLUSTER_TAG}", cluster)
        machines = self._find(*condition)
        groups = self._groups.find(name)
        return Observed(
            machines=tuple(m for m in machines if cluster in (None, m.cluster)),
            resources=(*groups, *self._key_pairs.find(cluster, groups)),
        )

    def _find(self, condition: str, value: str) -> list[MachineSeen]:
        reservations = self._calls.all_of(
            "describe_instances",
            "Reservations",
            "list the machines",
            Filters=[{"Name": condition, "Values": [value]}],
        )
        machines = []
        for reservation in reservations:
            for described in reservation["Instances"]:
                # A classic network names the groups of a reservation, not of an instance.
                groups = described.get("SecurityGroups") or reservation.get("Groups", [])
                machine = read_machine({**described, "SecurityGroups": groups})
                if machine is not None:
                    machines.append(machine)
        return machines

    def prepare(self, wanted: Prerequisites, observed: Observed) -> list[Step]:
        """Return what of security group, rules and key pair is missing."""
        return plan_access(self, wanted, observed)

    def create_key_pair(self, cluster: str, incarnation: str, public_key: str) -> KeyPairSeen:
        """Make the key pair of a cluster's life known, or return the one there is."""
        return self._key_pairs.create(cluster, incarnation, public_key)

    def create_group(self, cluster: str, incarnation: str, owner: Owner) -> GroupSeen:
        """Make the security group of a cluster, without rules; or return the one there is."""
        group = self._groups.create(cluster, incarnation, owner)
        if group.incarnation == incarnation and not group.owner.key:
            self.tag([], Tags(owner), [group])
            return replace(group, owner=owner)
        return group

    def tag(
        self, machines: Sequence[MachineSeen], tags: Tags, resources: Sequence[Resource] = ()
    ) -> None:
        """Write down what some machines and groups are to bear from now on."""
        texts: dict[str, str] = {}
        if tags.owner is not None:
            texts[OWNER_TAG] = str(tags.owner)
        if tags.desired is not None:
            texts[WORKERS_TAG] = str(tags.desired)
        if tags.set_up_by is not None:
            texts[SET_UP_TAG] = tags.set_up_by
        nameless: list[MachineSeen] = []
        if tags.lease_until is not None:
            texts[LEASE_TAG] = lease_text(tags.lease_until)
            # Whoever launched these was stopped before it had tagged them.
            nameless = [machine for machine in machines if machine.lease_until is None]
        ids = [machine.id for machine in machines if machine not in nameless]
        if self._knows.tags_on_groups:
            ids += [resource.id for resource in resources if resource.id]
        if ids:
            self._tag(ids, texts)
        for machine in nameless:
            identity = identity_tags(machine.cluster, machine.incarnation, machine.name)
            self._tag([machine.id], identity | texts)

    def allow(
        self, group: GroupSeen, ssh_from: frozenset[str], internal_ports: frozenset[int]
    ) -> None:
        """Make these the rules of a group: add what is missing, revoke what is too much."""
        self._groups.allow(group, ssh_from, internal_ports)

    def launch(self, launch: Launch) -> MachineSeen:
        """Start a machine; asked again with the same names, return the one that was started."""
        doing = f"launch {launch.name.node} ({launch.instance_type}, {launch.market})"
        groups = self._groups.find(group_name(launch.cluster))
        if not groups:
            raise CloudError(
                f"cannot {doing}: security group {group_name(launch.cluster)} is gone",
                "run hpcapp up again",
            )
        image = self._images.find(profile_of(self._cloud, launch.profile).image)
        parameters = launch_parameters(self._cloud, self._knows, launch, groups[0].id, image)
        try:
            reply = self._calls.call(
                "run_instances", doing, not_yet=_NOT_YET_FOR_LAUNCH, **parameters
            )
        except CloudError as error:
            if code_of(error) != "IdempotentParameterMismatch":
                raise
            return self._launched_before(launch, error)
        machine = as_machine(reply["Instances"][0], launch.cluster, launch.incarnation, launch.name)
        # A token may be remembered longer than its machine.
        if not self._knows.tags_at_launch and machine.state is not State.GONE:
            self._tag([machine.id], launch_tags(launch))
        owner = machine.owner if machine.owner.key else launch.owner
        desired = machine.desired or launch.desired
        return replace(machine, lease_until=launch.lease_until, owner=owner, desired=desired)

    def _launched_before(self, launch: Launch, error: CloudError) -> MachineSeen:
        """Return the machine that an earlier `up` launched by the same token.

        Its lease, and so its user data, was another.
        """
        token = client_token(launch.cluster, launch.incarnation, launch.name, attempt_of(launch))
        for _ in self._calls.tries():  # the lists may lag behind
            for machine in self._find("client-token", token):
                if machine.state is not State.GONE:
                    known = Owner() if machine.owner.key else launch.owner
                    self._tag([machine.id], launch_tags(replace(launch, owner=known)))
                return machine
        raise error

    def _tag(self, ids: list[str], tags: dict[str, str]) -> None:
        self._calls.call(
            "create_tags",
            f"tag {', '.join(ids)}",
            not_yet=_NOT_YET_FOR_TAGS,
            Resources=ids,
            Tags=[{"Key": key, "Value": value} for key, value in tags.items()],
        )

    def terminate(self, machines: Sequence[MachineSeen]) -> None:
        """Begin to end some machines; those that have ended do not matter."""
        ids = [machine.id for machine in machines]
        if not ids:
            return
        try:
            self._end(ids)
        except CloudError as error:
            if code_of(error) != _NO_INSTANCE:
                raise
            # One that the cloud does not know keeps all the others alive.
            for id_ in ids:
                self._end_if_there(id_)

    def _end(self, ids: list[str], not_yet: Collection[str] = ()) -> None:
        self._calls.call(
            "terminate_instances",
            f"terminate {', '.join(ids)}",
            not_yet=not_yet,
            InstanceIds=ids,
        )

    def _end_if_there(self, id_: str) -> None:
        try:
            self._end([id_], _NOT_YET)
        except CloudError as error:
            if code_of(error) != _NO_INSTANCE:
                raise

    def cleanup(self, resource: Resource) -> bool:
        """Delete a group or a key pair; False while it is in use."""
        if resource.bears_life:
            return self._groups.delete(resource)
        self._key_pairs.delete(resource)
        return True

    def console(self, machine: MachineSeen) -> str:
        """Return what a machine has printed on its console so far."""
        doing = f"read the console of {machine.name.node}"
        latest = {"Latest": True} if self._knows.latest_console else {}
        try:
            reply = self._console(machine, doing, **latest)
        except CloudError as error:
            # Some of Amazon's instance types show it only as of some minutes ago.
            if code_of(error) != "UnsupportedOperation":
                raise
            reply = self._console(machine, doing)
        return str(reply.get("Output") or "")

    def _console(self, machine: MachineSeen, doing: str, **latest: bool) -> Described:
        return self._calls.call(
            "get_console_output", doing, not_yet=_NOT_YET, InstanceId=machine.id, **latest
        )

    def check(self) -> list[Problem]:
        """Look, without changing anything, for what would make `up` fail."""
        return check_cloud(self._calls, self._cloud, self._knows, self._images)

    def bucket(self) -> S3Bucket | None:
        """Return the bucket that the cluster file names; None where it names none."""
        return self._open_bucket()

    def decided(self) -> tuple[str, ...]:
        """Say which images were found for profiles that name none by its id."""
        return self._images.decided(self._cloud)
