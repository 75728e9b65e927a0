"""A provider's block answers what it is, so that nobody asks for its class or type."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import pytest

from hpccomponent.config.reader import ConfigModel, parse_config
from hpccomponent.errors import ConfigError
from hpcdeploy.providers import open_provider
from hpcdeploy.providers.ec2.capabilities import capabilities_of
from hpcdeploy.spec.cluster import ClusterSpec, read_spec
from hpcdeploy.spec.provider import Ec2Spec, LocalSpec, SshSpec

PROFILES = "profiles: {any: {image: {id: ami-1}, instance_type: any}}"
ENDPOINT = "http://cloud.example/"
BLOCKS = {
    "aws": f"type: aws, {PROFILES}",
    "eucalyptus": f"type: eucalyptus, endpoint_url: '{ENDPOINT}', {PROFILES}",
    "ec2": f"type: ec2, endpoint_url: '{ENDPOINT}', {PROFILES}",
    "ssh": "type: ssh, hosts: [{address: a}, {address: b}]",
    "local": "type: local",
}
CLOUDS = ("aws", "eucalyptus", "ec2")


def spec_of(kind: str) -> ClusterSpec:
    text = f"version: 1\ncluster: c\nprovider: {{{BLOCKS[kind]}}}"
    return parse_config(text, "c.yaml", ClusterSpec)


@pytest.mark.parametrize("kind", BLOCKS)
def test_a_block_and_its_provider_agree(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIAEXAMPLE")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    spec = spec_of(kind)
    opened = open_provider(spec, tmp_path)
    assert spec.provider.makes_machines == opened.makes_machines == (kind in CLOUDS)


@pytest.mark.parametrize("kind", BLOCKS)
def test_only_what_makes_machines_has_a_cloud_and_profiles(kind: str) -> None:
    spec = spec_of(kind)
    assert (spec.provider.cloud is not None) == spec.provider.makes_machines
    assert bool(spec.profiles()) == spec.provider.makes_machines


@pytest.mark.parametrize("kind", BLOCKS)
def test_on_this_machine_all_is_the_users_own(kind: str) -> None:
    block = spec_of(kind).provider
    assert (block.is_here, block.is_shared) == (kind == "local", kind != "local")


VALUES: dict[str, str] = {
    "head.profile": "any",
    "head.component": "true",
    "workers.profile": "any",
    "workers.count": "1",
    "workers.min": "1",
    "communicator.port": "7071",
    "auth.ssh_user": "me",
    "auth.ssh_private_key": "auto",
    "auth.ssh_port": "2222",
    "auth.allow_from": "[auto]",
    "auth.ssh_proxy_jump": "gate",
    "limits.lease": "3h",
    "limits.idle": "20m",
    "limits.boot": "6m",
    "limits.max_hourly_cost": "2.0",
    "limits.max_total_cost": "9.0",
    "env.package": "auto",
    "env.python": '">=3.11"',
    "env.setup": "['true']",
    "env.packages": "[lazrs]",
    "env.wheelhouse": "wheels",
    "data.s3": "s3://bucket/prefix",
    "tags": "{project: x}",
}


def keys_beside_the_provider() -> set[str]:
    found = set()
    for name, field in ClusterSpec.model_fields.items():
        block = field.annotation
        if isinstance(block, type) and issubclass(block, ConfigModel):
            found |= {f"{name}.{inner}" for inner in block.model_fields}
        else:
            found.add(name)
    return found


def test_every_key_counts_somewhere_and_none_is_made_up() -> None:
    declared = [spec_of(kind).provider.honours for kind in BLOCKS]
    assert frozenset().union(*declared) == keys_beside_the_provider()
    assert VALUES.keys() == keys_beside_the_provider() - {"version", "cluster", "provider"}


@pytest.mark.parametrize("kind", BLOCKS)
@pytest.mark.parametrize("key", VALUES)
def test_a_key_counts_or_is_a_mistake_at_its_place(kind: str, key: str, tmp_path: Path) -> None:
    (tmp_path / "wheels").mkdir()
    block, _, inner = key.partition(".")
    rest = f"{block}:\n  {inner}: {VALUES[key]}" if inner else f"{block}: {VALUES[key]}"
    path = tmp_path / "c.yaml"
    path.write_text(f"version: 1\ncluster: c\nprovider: {{{BLOCKS[kind]}}}\n{rest}\n")
    if key in spec_of(kind).provider.honours:
        read_spec(path)
        return
    with pytest.raises(ConfigError) as caught:
        read_spec(path)
    place = "5:3" if inner else "4:1"
    assert str(caught.value).startswith(
        f"{path}:{place}: {key}: has no effect with provider {kind}"
    )
    assert "\n" not in str(caught.value)


def test_all_hosts_but_the_head_are_workers() -> None:
    spec = spec_of("ssh")
    assert [host.address for host in spec.provider.fixed_hosts] == ["a", "b"]
    assert spec.worker_count == 1


class NewCloud(Ec2Spec):
    """A cloud of a type of its own."""

    type: Literal["new"]  # type: ignore[assignment]


class NewHosts(SshSpec):
    """Hosts that another program names."""

    type: Literal["new"]  # type: ignore[assignment]


class NewFolders(LocalSpec):
    """Nodes on this machine, made otherwise."""

    type: Literal["new"]  # type: ignore[assignment]


def test_a_new_type_inherits_all_answers() -> None:
    profiles: Any = {"any": {"image": {"id": "ami-1"}, "instance_type": "any"}}
    cloud = NewCloud(type="new", endpoint_url=ENDPOINT, profiles=profiles)
    model = Ec2Spec(type="ec2", endpoint_url=ENDPOINT, profiles=profiles)
    assert cloud.makes_machines
    assert capabilities_of(cloud) == capabilities_of(model)
    hosts: Any = [{"address": "a"}]
    assert len(NewHosts(type="new", hosts=hosts).fixed_hosts) == 1
    assert NewFolders(type="new").is_here


def test_a_host_may_be_written_as_ssh_takes_it() -> None:
    text = (
        "version: 1\ncluster: c\nprovider: {type: ssh, hosts: [10.0.0.7, me@lab:2222, '[fe80::1]']}"
    )
    spec = parse_config(text, "c.yaml", ClusterSpec)
    hosts = [(host.address, host.user, host.port) for host in spec.provider.fixed_hosts]
    assert hosts == [("10.0.0.7", None, None), ("lab", "me", 2222), ("fe80::1", None, None)]


def test_of_hosts_that_are_wrong_each_has_one_line_and_none_is_said_to_be_missing() -> None:
    text = "version: 1\ncluster: c\nprovider:\n  type: ssh\n  hosts: [a b, lab:99999, {adress: x}]"
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "c.yaml", ClusterSpec)
    lines = str(caught.value).splitlines()
    assert [line.split(": ")[1] for line in lines] == [
        "provider.hosts[0]",
        "provider.hosts[1]",
        "provider.hosts[2].address",
        "provider.hosts[2].adress",
    ]
    assert "should be [USER@]HOST[:PORT]" in lines[0]
