"""Every mistake in a cluster file is named at its line and column, all of them at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from hpccomponent.errors import ConfigError
from hpcdeploy.spec.cluster import ClusterSpec, read_spec
from hpcdeploy.spec.provider import SshSpec

PROVIDERS = {
    "aws": """
  type: aws
  profiles:
    small: {image: {id: ami-1}, instance_type: m6i.large}
    fast: {image: {id: ami-1}, instance_type: [c6i.xlarge, c6a.xlarge], market: spot}
""",
    "eucalyptus": """
  type: eucalyptus
  region: cloud.example.org
  endpoint_url: http://clc.example:8773/services/compute/
  profiles:
    small: {image: {id: emi-1}, instance_type: m1.small}
    fast: {image: {id: emi-1}, instance_type: m1.large, market: spot_with_fallback}
""",
    "ec2": """
  type: ec2
  endpoint_url: http://cloud.example:8788
  profiles:
    small: {image: {id: ami-1}, instance_type: m1.small}
    fast: {image: {id: ami-1}, instance_type: m1.large}
""",
    "ssh": """
  type: ssh
  hosts: [{address: lab1}, {address: lab2, user: me, port: 2222}, {address: lab3}, {address: lab4}]
""",
    "local": """
  type: local
""",
}
REST = """
head: {profile: small}
workers: {profile: fast, count: 3, min: 2}
limits: {lease: 2h, idle: 15m, max_hourly_cost: 2.0}
tags: {project: x}
"""


def written(folder: Path, provider: str, rest: str = "") -> Path:
    path = folder / "cluster.yaml"
    path.write_text(f"version: 1\ncluster: bunny\nprovider:{provider.rstrip()}\n{rest}")
    return path


def spec_of(folder: Path, provider: str, rest: str = "") -> ClusterSpec:
    return read_spec(written(folder, provider, rest))


def complaints(folder: Path, provider: str, rest: str = "") -> list[str]:
    path = written(folder, provider, rest)
    with pytest.raises(ConfigError) as caught:
        read_spec(path)
    assert caught.value.exit_code == 2
    return str(caught.value).replace(str(path), "c").replace(str(folder), "HERE").splitlines()


@pytest.mark.parametrize("kind", PROVIDERS)
def test_one_file_serves_every_provider_but_for_what_a_cloud_alone_has(
    kind: str, tmp_path: Path
) -> None:
    has_profiles = kind not in ("ssh", "local")
    rest = REST if has_profiles else "workers: {count: 3, min: 2}"
    spec = spec_of(tmp_path, PROVIDERS[kind], rest)
    assert spec.nodes() == ("head", "worker-1", "worker-2", "worker-3")
    assert (spec.worker_count, spec.worker_min) == (3, 2)
    assert spec.profile_name("head") == ("small" if has_profiles else "")
    assert spec.profile_name("worker-2") == ("fast" if has_profiles else "")
    assert (spec.profile("head") is not None) == has_profiles


def test_the_only_profile_is_everybodys(tmp_path: Path) -> None:
    only = "\n  type: aws\n  profiles: {one: {image: {id: ami-1}, instance_type: t3.small}}"
    spec = spec_of(tmp_path, only)
    assert spec.profile_name("head") == spec.profile_name("worker-1") == "one"
    assert spec.profile("worker-1") == spec.profiles()["one"]
    assert (spec.worker_count, spec.worker_min) == (1, 1)


def test_hosts_that_are_left_are_workers(tmp_path: Path) -> None:
    spec = spec_of(tmp_path, PROVIDERS["ssh"])
    assert (spec.worker_count, spec.worker_min) == (3, 3)
    assert isinstance(spec.provider, SshSpec)
    assert spec.provider.hosts[1].port == 2222


CLOUD = "\n  type: aws\n  profiles:\n    one: {image: {id: ami-1}, instance_type: t3.small"


@pytest.mark.parametrize(
    ("provider", "rest", "complaint"),
    [
        (
            PROVIDERS["aws"],
            "head: {profile: smal}\nworkers: {profile: fast}",
            "c:8:8: head.profile: no such profile in provider.profiles (got 'smal'), "
            'did you mean "small"?',
        ),
        (
            PROVIDERS["aws"],
            "workers: {profile: fast}",
            "c:1:1: head.profile: missing key, one of fast, small",
        ),
        (
            CLOUD + "}",
            "workers:\n  min: 2",
            "c:8:3: workers.min: exceeds workers.count, 1 (got 2)",
        ),
        (
            CLOUD + "}",
            "head: {component: false}\nworkers: {count: 0}",
            "c:7:8: head.component: nobody works: there are no workers and the head does not "
            "(got false)",
        ),
        (
            PROVIDERS["ssh"],
            "workers: {count: 4}",
            "c:5:3: provider.hosts: a head and 4 workers take 5 hosts, here are 4: name more, or "
            "lower workers.count",
        ),
        (
            "\n  type: ssh\n  hosts: [{address: a}, {address: a, port: 22}]",
            "",
            "c:5:26: provider.hosts[1].address: given twice (got 'a')",
        ),
        (
            "\n  type: ssh\n  hosts: [{address: a}, {address: b, port: 7070}]",
            "",
            "c:5:38: provider.hosts[1].port: is communicator.port too (got 7070)",
        ),
        (
            CLOUD + "}",
            "communicator: {port: 2222}\nauth: {ssh_port: 2222}",
            "c:7:16: communicator.port: is auth.ssh_port too, choose another (got 2222)",
        ),
        (
            CLOUD + "}",
            "limits: {lease: 10m}",
            "c:7:1: limits.idle: exceeds limits.lease, at whose end all machines go",
        ),
        (
            CLOUD + "}",
            "limits: {lease: 2 hours}",
            "c:7:10: limits.lease: should be a duration such as 90s, 15m or 2h (got '2 hours')",
        ),
        (
            CLOUD + "}",
            "limits: {idle: 0s}",
            "c:7:10: limits.idle: should be longer than nothing (got '0s')",
        ),
        (
            CLOUD + "}",
            "auth:\n  allow_from: [auto, 10.0.0.300]",
            "c:8:22: auth.allow_from[1]: should be auto or an IPv4 network such as 192.0.2.0/24 "
            "(got '10.0.0.300')",
        ),
        (
            CLOUD + "}",
            "auth:\n  allow_from: [10.0.0.7/24]",
            "c:8:16: auth.allow_from[0]: should be the network 10.0.0.0/24 (got '10.0.0.7/24')",
        ),
        (
            CLOUD + ", market: spot}".replace("}", "}\n  capabilities: generic"),
            "",
            "c:6:56: provider.profiles.one.market: this cloud has no spot machines: on_demand or "
            "spot_with_fallback will do (got 'spot')",
        ),
        (
            CLOUD + ", public_ip: true}".replace("}", "}\n  capabilities: euca-4.0"),
            "",
            "c:6:56: provider.profiles.one.public_ip: this cloud cannot be told whether machines "
            "get a public address: leave it out, or set provider.capabilities (got true)",
        ),
        (
            PROVIDERS["local"],
            "env:\n  setup: [make]",
            "c:6:3: env.setup: has no effect with provider local (its nodes are folders that run "
            "this very installation): leave it out",
        ),
        (
            CLOUD + ", disk_gb: 0}",
            "",
            "c:6:56: provider.profiles.one.disk_gb: should be greater than or equal to 1 (got 0)",
        ),
        (
            CLOUD + ", instance_typ: x}",
            "",
            "c:6:56: provider.profiles.one.instance_typ: unknown key, "
            'did you mean "instance_type"?',
        ),
        (
            CLOUD + "}\n  credentials: {profile: a, euca_ini: cluster.yaml}",
            "",
            "c:7:29: provider.credentials.euca_ini: the keys are given twice, by profile already: "
            "leave one out (got 'cluster.yaml')",
        ),
        (
            CLOUD + "}\n  region: lab.example.org",
            "",
            "c:7:3: provider.region: no legal name of a region: give signing_region beside it "
            "(got 'lab.example.org')",
        ),
        (
            CLOUD + "}\n  endpoint_url: cloud.example",
            "",
            "c:7:3: provider.endpoint_url: should be a URL such as "
            "https://cloud.example:8773/services/compute/ (got 'cloud.example')",
        ),
        (
            CLOUD + "}\n  endpoint_url: http://me:secret@cloud.example/",
            "",
            "c:7:3: provider.endpoint_url: should be a URL without user, password and query; "
            "see credentials (got 'http://me:...@cloud.example/')",
        ),
        (
            CLOUD + "}\n  ca_bundle: certificates.pem",
            "",
            "c:7:3: provider.ca_bundle: no such file, looked for it from HERE "
            "(got 'certificates.pem')",
        ),
        (
            CLOUD + "}",
            "auth: {ssh_private_key: id}",
            "c:7:8: auth.ssh_private_key: no such file, looked for it from HERE (got 'id')",
        ),
        (
            CLOUD + "}",
            "env: {wheelhouse: wheels}",
            "c:7:7: env.wheelhouse: no such folder, looked for it from HERE (got 'wheels')",
        ),
        (
            CLOUD + "}",
            "env:\n  packages: [numpy, mine.whl]",
            "c:8:21: env.packages[1]: no such file, looked for it from HERE (got 'mine.whl')",
        ),
        (
            CLOUD + "}",
            'env: {python: ">=3.9"}',
            'c:7:7: env.python: should be ">=3.11" or a later one, hpcapp needs 3.11 '
            "(got '>=3.9')",
        ),
    ],
)
def test_a_mistake_is_named_at_its_place(
    provider: str, rest: str, complaint: str, tmp_path: Path
) -> None:
    assert complaint in complaints(tmp_path, provider, rest)


def test_all_mistakes_are_named_at_once(tmp_path: Path) -> None:
    rest = """\
wokers: {count: 3}
head: {profile: smal}
limits: {lease: 1m}
communicator: {port: 22, prot: 7}
auth: {allow_from: []}
tags: {"hpcapp:cluster": mine}
"""
    found = complaints(tmp_path, PROVIDERS["aws"], rest)
    assert [line.split(": ")[1] for line in found] == [
        "workers.profile",
        "wokers",
        "head.profile",
        "limits.idle",
        "communicator.port",
        "communicator.prot",
        "auth.allow_from",
        "tags.hpcapp:cluster",
    ]


def test_profiles_are_merged_from_one_another(tmp_path: Path) -> None:
    base = "&base {image: {id: ami-1}, instance_type: t3.small, disk_gb: 30}"
    merged = "{<<: *base, instance_type: c6i.xlarge, market: spot}"
    profiles = f"\n  type: aws\n  profiles:\n    small: {base}\n    fast: {merged}\n"
    found = spec_of(tmp_path, profiles, REST).profiles()
    assert found["fast"].disk_gb == found["small"].disk_gb == 30
    assert found["fast"].image == found["small"].image
    assert found["fast"].instance_type != found["small"].instance_type
    assert (found["fast"].market, found["small"].market) == ("spot", "on_demand")


def test_a_home_of_nobody_is_a_mistake_at_its_place(tmp_path: Path) -> None:
    rest = "auth: {ssh_private_key: ~no-such-user/id}\nenv: {wheelhouse: ~no-such-user/wheels}"
    assert complaints(tmp_path, CLOUD + "}", rest) == [
        "c:7:8: auth.ssh_private_key: no such file: ~no-such-user/id: this machine knows no user "
        "'no-such-user' (got '~no-such-user/id')",
        "c:8:7: env.wheelhouse: no such folder: ~no-such-user/wheels: this machine knows no user "
        "'no-such-user' (got '~no-such-user/wheels')",
    ]


def test_files_are_found_beside_the_cluster_file(tmp_path: Path) -> None:
    (tmp_path / "wheels").mkdir()
    (tmp_path / "cloud.pem").touch()
    spec = spec_of(
        tmp_path, CLOUD + "}\n  ca_bundle: cloud.pem", "env: {wheelhouse: wheels, package: auto}"
    )
    assert spec.env.wheelhouse == "wheels"
