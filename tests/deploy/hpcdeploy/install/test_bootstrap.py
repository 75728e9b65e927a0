"""Setting machines up: real loaders, real shells; and what a second run must leave alone."""

from __future__ import annotations

import json
import os
import select
import signal
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from hpccomponent.errors import CloudError
from hpccomponent.inventory import read_inventory
from hpccomponent.protocol.connection import read_connection
from hpcdeploy.install.bootstrap import set_up
from hpcdeploy.login.access import Access
from hpcdeploy.provider import Launch, MachineSeen
from hpcdeploy.providers.local import LocalProvider
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import NodeName

FOLDER = "hpcapp/desk"
NODES = ("head", "worker-1")


def end_process(pid: int) -> None:
    """Kill a process that is not our child, and wait until it is gone."""
    gone = os.pidfd_open(pid)
    os.kill(pid, signal.SIGTERM)
    assert select.select([gone], [], [], 20)[0]
    os.close(gone)


@pytest.fixture
def spec() -> ClusterSpec:
    return ClusterSpec.model_validate(
        {"version": 1, "cluster": "desk", "provider": {"type": "local"}}
    )


@pytest.fixture
def access(spec: ClusterSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Access]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    provider = LocalProvider()
    access = Access(spec, tmp_path, provider)
    for node in NODES:
        provider.launch(Launch("desk", "life", NodeName(node)))
    yield access
    access.close()
    provider.terminate(machines())
    assert machines() == ()


def machines() -> tuple[MachineSeen, ...]:
    return LocalProvider().observe("desk").machines


def loader_pids() -> list[str]:
    paths = [Path(machine.id) / FOLDER / "loader.pid" for machine in machines()]
    return [path.read_text() for path in paths if path.exists()]


def test_every_node_gets_its_own_keys_and_a_loader(spec: ClusterSpec, access: Access) -> None:
    assert set_up(spec, machines(), access, print) == {}
    connections = [
        read_connection(Path(machine.id) / FOLDER / "connection.json") for machine in machines()
    ]
    assert {connection.worker for connection in connections} == set(NODES)
    assert len({connection.secret_key for connection in connections}) == 2
    inventory = read_inventory(Path(machines()[0].id) / FOLDER / "inventory.json")
    assert inventory.bind == "tcp://127.0.0.1:7070" == connections[0].endpoint
    listed = {worker.name: worker.public_key for worker in inventory.workers}
    assert listed == {connection.worker: connection.public_key for connection in connections}
    assert len(loader_pids()) == 2
    for pid, started in map(str.split, loader_pids()):
        assert Path(f"/proc/{pid}/stat").read_text().split()[21] == started


def test_a_second_run_changes_nothing_and_secrets_are_their_owners_only(
    spec: ClusterSpec, access: Access, tmp_path: Path
) -> None:
    set_up(spec, machines(), access, print)
    before = loader_pids()
    said: list[str] = []
    assert set_up(spec, machines(), access, said.append) == {}
    assert said == []
    assert loader_pids() == before
    secret = [*tmp_path.rglob("connection.json"), *tmp_path.rglob("inventory.json")]
    secret += tmp_path.rglob("keys.json")
    assert len(secret) == 4
    assert {stat.S_IMODE(path.stat().st_mode) for path in secret} == {0o600}


def test_a_node_that_left_is_no_longer_admitted(spec: ClusterSpec, access: Access) -> None:
    set_up(spec, machines(), access, print)
    head, worker = machines()
    LocalProvider().terminate([worker])
    set_up(spec, machines(), access, print)
    inventory = json.loads((Path(head.id) / FOLDER / "inventory.json").read_text())
    assert [worker["name"] for worker in inventory["workers"]] == ["head"]


def test_a_loader_that_has_died_is_started_again(spec: ClusterSpec, access: Access) -> None:
    set_up(spec, machines(), access, print)
    before = loader_pids()
    end_process(int(before[0].split()[0]))
    set_up(spec, machines(), access, print)
    assert len(loader_pids()) == 2
    assert before[1] in loader_pids()
    assert before[0] not in loader_pids()


def test_a_cluster_without_a_head_is_none(spec: ClusterSpec, access: Access) -> None:
    with pytest.raises(CloudError, match="desk has no head that runs"):
        set_up(spec, machines()[1:], access, print)
