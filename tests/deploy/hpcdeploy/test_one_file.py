"""One cluster file on every cloud, changed in its provider block only; and what keys must allow."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from cloud import RSA_KEY, StrictCloud
from pydantic import TypeAdapter
from simulated import SimulatedTime, open_file, stub_set_up
from typed import run

from hpcdeploy.providers.ec2.capabilities import capabilities_of
from hpcdeploy.reconcile.converge import bring_up, take_down
from hpcdeploy.spec.provider import CloudSpec, ProviderSpec

ROOT = Path(__file__).parents[3]
REST = """
head: {profile: small}
workers: {profile: fast, count: 3, min: 2}
auth: {allow_from: [192.0.2.0/24]}
limits: {lease: 2h, idle: 15m, max_hourly_cost: 2.00, max_total_cost: 5.00}
tags: {project: x}
"""


@pytest.fixture
def profile() -> str:
    return "aws"


@pytest.fixture
def cloud(profile: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StrictCloud]:
    stub_set_up(monkeypatch, tmp_path / "state")
    monkeypatch.setattr("hpcdeploy.install.wheels.requirements.check_wheels", lambda spec, base: [])
    with StrictCloud(profile, lag=0) as opened:
        for name, value in opened.environment().items():
            monkeypatch.setenv(name, value)
        yield opened


def write_file(cloud: StrictCloud, folder: Path, **changes: Any) -> Path:
    """Write the one file, with the block of a cloud; JSON is YAML too."""
    price: dict[str, object] = {"hourly_cost": 0.2} if cloud.profile == "generic" else {}
    block = cloud.provider_block(small=price, fast={"market": "spot_with_fallback"} | price)
    path = folder / "cluster.yaml"
    path.write_text(f"version: 1\ncluster: bunny\nprovider: {json.dumps(block | changes)}\n{REST}")
    return path


every_cloud = pytest.mark.parametrize(
    "profile", ["aws", "euca-4.0", "euca-4.4", "euca-5.1", "generic"]
)


@every_cloud
def test_validate_and_plan(
    cloud: StrictCloud, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_file(cloud, tmp_path)
    assert run("validate", path) == 0
    assert not cloud.calls
    assert run("plan", path) == 0
    told = capsys.readouterr().out
    assert all(f"would launch {node}" in told for node in ("head", "worker-1", "worker-3"))
    assert not [call for call in cloud.calls if call.changes]


@pytest.mark.slow
@every_cloud
def test_up_again_and_down(cloud: StrictCloud, tmp_path: Path) -> None:
    cluster, lines, time = (
        open_file(write_file(cloud, tmp_path), RSA_KEY),
        list[str](),
        SimulatedTime(),
    )
    bring_up(cluster, lines.append, polling=time.polling())
    assert [m.name.node for m in cluster.machines()] == ["head", "worker-1", "worker-2", "worker-3"]
    calls = len(cloud.calls)
    bring_up(cluster, lines.append, polling=time.polling())
    assert not [call for call in cloud.calls[calls:] if call.changes]
    take_down(cluster, lines.append, polling=time.polling())
    assert not cloud.left()


def allowed_actions() -> set[str]:
    """Return the EC2 actions of the page's policy."""
    page = (ROOT / "docs/how-to/describe-a-cluster.md").read_text(encoding="utf-8")
    _, _, text = page.partition("```json\n")
    statements = json.loads(text.partition("```")[0])["Statement"]
    return {
        action.removeprefix("ec2:")
        for statement in statements
        for action in statement["Action"]
        if action.startswith("ec2:")
    }


def test_the_pages_policy_allows_what_is_called_and_nothing_else(
    cloud: StrictCloud, tmp_path: Path
) -> None:
    subnet = cloud.model.default_subnet(None)
    cluster = open_file(write_file(cloud, tmp_path, subnet=subnet), RSA_KEY)
    lines, time = list[str](), SimulatedTime()
    cluster.provider.check()
    bring_up(cluster, lines.append, polling=time.polling())
    cluster.provider.console(cluster.head())
    time.advance(timedelta(hours=1).total_seconds())
    auth = cluster.spec.auth.model_copy(update={"allow_from": ("198.51.100.0/24",)})
    elsewhere = replace(cluster, spec=cluster.spec.model_copy(update={"auth": auth}))
    bring_up(elsewhere, lines.append, polling=time.polling())
    take_down(cluster, lines.append, polling=time.polling())
    assert {call.action for call in cloud.calls} == allowed_actions()


@pytest.mark.parametrize("kind", ["aws", "eucalyptus", "ec2"])
@pytest.mark.parametrize("profile", ["auto", "aws", "euca-4.0", "euca-5.1", "generic"])
def test_the_file_knows_which_clouds_have_spot_machines(kind: str, profile: str) -> None:
    block: Any = {
        "type": kind,
        "capabilities": profile,
        "endpoint_url": "http://cloud.example/",
        "profiles": {"small": {"image": {"id": "ami-1"}, "instance_type": "m5.large"}},
    }
    cloud = TypeAdapter(ProviderSpec).validate_python(block)
    assert isinstance(cloud, CloudSpec)
    assert cloud.has_spot == capabilities_of(cloud).spot
