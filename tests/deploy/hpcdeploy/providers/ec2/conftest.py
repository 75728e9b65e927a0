"""The EC2 provider on a strict cloud, with waits that are written down instead of waited."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from botocore.loaders import create_loader
from cloud import RSA_KEY, StrictCloud
from pydantic import TypeAdapter

from hpcdeploy.provider import Launch, MachineSeen
from hpcdeploy.providers.ec2.client import Calls, open_client
from hpcdeploy.providers.ec2.provider import Ec2Provider
from hpcdeploy.spec.names import NodeName, Owner
from hpcdeploy.spec.provider import ProviderSpec

OWNER = Owner("anna@lab", "SHA256:abc")
LEASE = datetime(2030, 1, 2, 3, 4, 5, tzinfo=UTC)
OPEN = frozenset({"192.0.2.0/24"})


@pytest.fixture(scope="session", autouse=True)
def one_loader() -> Iterator[None]:
    """Read boto3's description of EC2 once: it takes longer than most tests."""
    loader = create_loader()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("botocore.session.create_loader", lambda *_: loader)
        yield


@dataclass
class Desk:
    """A cloud, a provider that works on it, and how long it would have waited."""

    cloud: StrictCloud
    provider: Ec2Provider
    waits: list[float] = field(default_factory=list)

    def prepare(self) -> None:
        """Make what a launch needs, as `up` does."""
        self.provider.create_key_pair("bunny", "a1b2c3", RSA_KEY)
        group = self.provider.create_group("bunny", "a1b2c3", OWNER)
        self.provider.allow(group, OPEN, frozenset({7070}))

    def launch(self, node: str = "worker-1", **more: Any) -> MachineSeen:
        return self.provider.launch(a_launch(node, **more))

    def reopened(self, base: Path = Path(), **keys: Any) -> Ec2Provider:
        """Open another provider, by the environment as it is now, and with other keys."""
        spec = self.provider._cloud.model_copy(update=keys)
        calls = Calls(open_client("ec2", spec, base), "the cloud", self.waits.append)
        return Ec2Provider(spec, calls, 22)

    def changes(self) -> list[str]:
        return [call.action for call in self.cloud.calls if call.changes]


def a_launch(node: str = "worker-1", **more: Any) -> Launch:
    asked: dict[str, Any] = {
        "profile": "small",
        "instance_type": "m5.large",
        "user_data": "#!/bin/sh\n",
        "lease_until": LEASE,
        "tags": {"project": "x"},
        "owner": OWNER,
    }
    return Launch("bunny", "a1b2c3", NodeName(node), **(asked | more))


@pytest.fixture
def open_desk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Callable[..., Desk]]:
    """Give a function that starts a cloud of a profile and opens a provider on it."""
    clouds = []

    def start(profile: str, small: dict[str, Any] | None = None, **options: Any) -> Desk:
        keys = options.pop("provider", {})
        cloud = options.pop("cloud", None) or StrictCloud(profile, **options)
        clouds.append(cloud)
        for name, value in cloud.environment().items():
            monkeypatch.setenv(name, value)
        spec: Any = TypeAdapter(ProviderSpec).validate_python(
            cloud.provider_block(small=small or {}) | keys
        )
        waits: list[float] = []
        calls = Calls(open_client("ec2", spec, tmp_path), "the cloud", waits.append)
        return Desk(cloud, Ec2Provider(spec, calls, 22), waits)

    yield start
    for cloud in clouds:
        cloud.close()
