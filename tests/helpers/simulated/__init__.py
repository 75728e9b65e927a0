"""What simulated clusters are made of: a clock that only sleeping moves, files, stubs of set-up."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from hpccomponent.config.reader import parse_config
from hpcdeploy.login.ssh.reach import ReachError
from hpcdeploy.ownership.journal import peek_journal
from hpcdeploy.ownership.ownership import Ownership, fingerprint
from hpcdeploy.provider import MachineSeen, Observed
from hpcdeploy.providers import open_provider
from hpcdeploy.providers.ec2.observe import GroupSeen, KeyPairSeen
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.spec.cluster import ClusterSpec, read_spec
from hpcdeploy.spec.layout import state_folder
from hpcdeploy.spec.names import Owner
from hpcdeploy.spec.polling import Polling
from simulated.memory import MemoryProvider

START = datetime(2026, 11, 1, 12, 0, tzinfo=UTC)

FILE = """
version: 1
cluster: {cluster}
provider:
  type: aws
  profiles:
    small: {{image: {{id: ami-1}}, instance_type: m6i.large}}
    fast: {{image: {{id: ami-1}}, instance_type: [c6i.xlarge, c6a.xlarge], market: {market}}}
head: {{profile: small}}
workers: {{profile: fast, count: {count}, min: {least}}}
auth: {{allow_from: [192.0.2.0/24]}}
limits: {{lease: 2h}}
"""


def make_spec(
    count: int = 3, least: int = 0, market: str = "on_demand", cluster: str = "bunny"
) -> ClusterSpec:
    text = FILE.format(cluster=cluster, count=count, least=least, market=market)
    return parse_config(text, "cluster.yaml", ClusterSpec)


def groups_of(observed: Observed) -> list[GroupSeen]:
    return [seen for seen in observed.resources if isinstance(seen, GroupSeen)]


def key_pairs_of(observed: Observed) -> list[KeyPairSeen]:
    return [seen for seen in observed.resources if isinstance(seen, KeyPairSeen)]


@dataclass
class SimulatedTime:
    """A clock that stands still until somebody sleeps by it or advances it."""

    passed: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def now(self) -> datetime:
        return START + timedelta(seconds=self.passed)

    def advance(self, seconds: float) -> None:
        with self.lock:
            self.passed += seconds

    def polling(self, **changes: Any) -> Polling:
        return Polling(now=self.now, sleep=self.advance, **changes)


@dataclass
class SetUp:
    """Stands for the bootstrap: remembers what it was given, fails where it is told to."""

    broken_nodes: set[str] = field(default_factory=set)
    broken_once: set[str] = field(default_factory=set)
    during: Callable[[], object] = lambda: None
    calls: list[tuple[str, ...]] = field(default_factory=list)

    def __call__(
        self, spec: ClusterSpec, machines: Sequence[MachineSeen], access: object, report: object
    ) -> dict[str, str]:
        self.calls.append(tuple(machine.name.node for machine in machines))
        self.during()
        broken = self.broken_nodes | self.broken_once
        failed = [machine for machine in machines if machine.name.node in broken]
        self.broken_once -= {machine.name.node for machine in failed}
        return {machine.id: "pip is missing" for machine in failed}


def stub_set_up(patch: pytest.MonkeyPatch, home: Path, set_up: SetUp | None = None) -> SetUp:
    """Let commands keep what they know below a folder, and install nothing on machines."""
    stub = set_up or SetUp()
    patch.setenv("XDG_STATE_HOME", str(home))
    patch.setattr("hpcdeploy.install.bootstrap.set_up", stub)
    patch.setattr("hpcdeploy.install.user_data.user_data", lambda *about: "#!/bin/sh\n")
    return stub


@dataclass
class Keyring:
    """Stands for the access to machines: one user's key of a cluster, and who that user is.

    The nodes `silent` let nobody in.

    The key lies where the real one does, so that `down` forgets it and another home has another.
    """

    cluster: str
    user: str = "anna@lab"
    public: str | None = None
    silent: set[str] = field(default_factory=set)

    def open(self, machine: MachineSeen) -> ExitStack:
        """Let in, as a shell of which nothing is asked."""
        if machine.name.node in self.silent:
            raise ReachError(f"{machine.name.node} ({machine.id}): unreachable: no answer")
        return ExitStack()

    def public_key(self) -> str:
        path = state_folder(self.cluster) / "id"
        if self.public is None and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"ssh-rsa {secrets.token_hex(8)}")
        return self.public or path.read_text()

    def owner(self) -> Owner:
        return Owner(self.user, fingerprint(self.public_key()))

    def ownership(self) -> Ownership:
        lives = peek_journal(self.cluster).lives
        if self.public is None and not (state_folder(self.cluster) / "id").exists():
            return Ownership(Owner(self.user), lives=lives)
        return Ownership(self.owner(), frozenset({self.public_key()}), lives)


def make_cluster(
    spec: ClusterSpec, provider: MemoryProvider, user: str = "anna@lab", key: str | None = None
) -> Cluster:
    access: Any = Keyring(spec.cluster, user, key)
    return Cluster(Path("cluster.yaml"), spec, provider, access)


def open_file(path: Path, public_key: str) -> Cluster:
    """Open a cluster file as the verbs do, but with a key that is there and no shells."""
    spec = read_spec(path)
    access: Any = Keyring(spec.cluster, public=public_key)
    return Cluster(path, spec, open_provider(spec, path.parent), access)
