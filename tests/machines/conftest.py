"""SSH hosts and a cluster file of them; all that the wheels require, packed once from here."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import paramiko
import pytest
from machines.servers import USER, Machines, Server
from testbed.wheels import pack_requirements_of


@pytest.fixture(scope="session")
def wheelhouse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheelhouse")
    pack_requirements_of("hpcapp", folder)
    return folder


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    with Machines.open(tmp_path) as machines:
        yield machines


@pytest.fixture
def hosts(
    machines: Machines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[Server, Server]:
    """Two hosts that the user's ssh knows."""
    monkeypatch.setenv("HOME", str(tmp_path / "user"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = tmp_path / "user/.ssh"
    folder.mkdir(parents=True)
    key = paramiko.RSAKey.generate(2048)
    key.write_private_key_file(str(folder / "id_rsa"))
    servers = machines.add(), machines.add()
    for server in servers:
        server.keys.append(f"ssh-rsa {key.get_base64()}")
    lines = (f"[{s.address}]:{s.port} {s.host_line}\n" for s in servers)
    (folder / "known_hosts").write_text("".join(lines))
    return servers


@pytest.fixture
def file(hosts: tuple[Server, Server], tmp_path: Path) -> Path:
    path = tmp_path / "lab.yaml"
    hosts_of_file = [{"address": h.address, "port": h.port, "user": USER} for h in hosts]
    spec = {
        "version": 1,
        "cluster": "lab",
        "provider": {"type": "ssh", "hosts": hosts_of_file},
        "env": {"wheelhouse": "wheels"},
    }
    path.write_text(json.dumps(spec))
    (tmp_path / "wheels").mkdir()
    return path
