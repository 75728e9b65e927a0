"""The clouds that `ls --all` and `reap` look at: those of some files, or the environment's."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from hpccomponent.config.reader import parse_config
from hpcdeploy.provider import Provider
from hpcdeploy.providers import open_provider
from hpcdeploy.spec.cluster import ClusterSpec, read_spec
from hpcdeploy.spec.provider import CloudSpec

ANY_CLUSTER = """
version: 1
cluster: any
provider:
  type: aws
  region: {region}
  profiles: {{any: {{image: {{id: ami-0}}, instance_type: any}}}}
"""


class OpenCloud(NamedTuple):
    """A cloud that can be asked; `place` is a name to print.

    `spec` is its block of a file, for prices; None where machines are there anyway.
    """

    place: str
    provider: Provider
    spec: CloudSpec | None


def places_of(spec: ClusterSpec, hosts: Collection[str] | None = None) -> tuple[str, ...]:
    """Return in words where a cluster file's machines are: one for a cloud, one for each host.

    What is said before them is "in". The account is told by the profile of the keys only: keys
    themselves come and go. `hosts` are ids of some of the file's; by default all.
    """
    cloud = spec.provider.cloud
    if spec.provider.is_here:
        return ("folders of this machine",)
    if cloud is None:
        from hpcdeploy.login.ssh.target import host_id, host_target  # it imports paramiko

        return tuple(
            f"the home of {host_target(host, spec.auth, ()).user}@{host_id(host)}"
            for host in spec.provider.fixed_hosts
            if hosts is None or host_id(host) in hosts
        )
    keys = cloud.credentials
    source = keys.profile or keys.euca_ini or keys.eucarc or os.environ.get("AWS_PROFILE", "")
    place = f"{cloud.type} {cloud.endpoint_url or ''} {cloud.region}".replace("  ", " ")
    return (f"{place}, with the keys of {source}" if source else place,)


def open_clouds(files: Sequence[Path]) -> list[OpenCloud]:
    """Return the clouds of some cluster files, each once.

    Without a file, the AWS account and region of the environment. Raises ConfigError where a file
    has mistakes, CloudError where keys are not to be found.
    """
    if not files:
        from hpcdeploy.providers.ec2.login import default_region  # it imports boto3

        region = os.environ.get("AWS_REGION") or default_region() or "us-east-1"
        spec = parse_config(ANY_CLUSTER.format(region=region), "the environment", ClusterSpec)
        return [OpenCloud(f"aws {region}", open_provider(spec, Path.cwd()), spec.provider.cloud)]
    clouds: dict[str, OpenCloud] = {}
    for path in files:
        spec = read_spec(path)
        place = spec.provider.model_dump_json(exclude={"profiles"})
        if place not in clouds:
            provider = open_provider(spec, path.absolute().parent)
            clouds[place] = OpenCloud(str(path), provider, spec.provider.cloud)
    return list(clouds.values())
