"""From a file with SSH hosts to machines that work: a real environment, real loaders, real keys."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import paramiko
import pytest
from click.testing import CliRunner

from hpccomponent.errors import CloudError
from hpcdeploy.bootstrap import set_up
from hpcdeploy.cluster import Cluster, open_cluster
from hpcdeploy.doctor_command import doctor
from hpcdeploy.names import NodeName
from hpcdeploy.provider import Launch, State
from hpcdeploy.shell_command import exec_, get, put
from machines.servers import USER, Machines, Server

FOLDER = "hpcapp/lab"


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


def claim(cluster: Cluster) -> None:
    for node in cluster.spec.nodes():
        cluster.provider.launch(Launch("lab", "life", NodeName(node)))


@pytest.mark.slow
def test_hosts_become_a_cluster_and_are_left_as_they_were(
    file: Path, hosts: tuple[Server, Server], wheelhouse: Path
) -> None:
    (file.parent / "wheels").rmdir()
    (file.parent / "wheels").symlink_to(wheelhouse)
    for host in hosts:
        (host.home / "theirs").write_text("stays")
    said: list[str] = []
    with open_cluster(file) as cluster:
        claim(cluster)
        assert set_up(cluster.spec, cluster.machines(), cluster.access, said.append) == []
        worker = hosts[1].home / FOLDER
        assert not list(worker.glob("venv/lib/python*/site-packages/scipy"))
        assert (hosts[0].home / FOLDER / "venv/bin/hpcapp").exists()
        again: list[str] = []
        assert set_up(cluster.spec, cluster.machines(), cluster.access, again.append) == []
        assert again == []
        result = CliRunner().invoke(doctor, [str(file)])
        assert result.exit_code == 0, result.output
        assert "worker-1: good" in result.output
        cluster.provider.terminate(cluster.machines())
        assert cluster.machines() == ()
    for host in hosts:
        assert (host.home / "theirs").read_text() == "stays"
        assert not (host.home / "hpcapp").exists()


def test_missing_wheels_fail_each_machine_with_one_line(file: Path) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
        failures = set_up(cluster.spec, cluster.machines(), cluster.access, print)
    assert {failure.machine.name.node for failure in failures} == {"head", "worker-1"}
    for failure in failures:
        assert "the wheelhouse has no" in failure.reason
        assert "\n" not in failure.reason


def test_a_host_that_vanished_counts_as_stopped_with_the_reason(
    file: Path, hosts: tuple[Server, Server], machines: Machines
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
        machines.stop(hosts[1])
        head, worker = cluster.provider.observe("lab").machines
        assert (head.state, worker.state) == (State.RUNNING, State.STOPPED)
        assert "connection refused" in worker.reason
        with pytest.raises(CloudError, match="connection refused"):
            cluster.provider.launch(Launch("lab", "life", NodeName("worker-1")))


def test_commands_run_on_all_and_the_worst_code_counts(
    file: Path, hosts: tuple[Server, Server]
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    (hosts[1].home / "bad").touch()
    result = CliRunner().invoke(exec_, [str(file), "--all", "echo here; test ! -e bad || exit 7"])
    assert result.exit_code == 7, result.output
    assert sorted(result.output.splitlines()) == ["head: here", "worker-1: here"]


def test_files_go_to_the_head_and_come_back(
    file: Path, hosts: tuple[Server, Server], tmp_path: Path
) -> None:
    with open_cluster(file) as cluster:
        claim(cluster)
    (tmp_path / "cloud.ply").write_bytes(b"ply\n" * 1000)
    assert CliRunner().invoke(put, [str(file), str(tmp_path / "cloud.ply")]).exit_code == 0
    assert (hosts[0].home / "cloud.ply").stat().st_size == 4000
    target = tmp_path / "back.ply"
    assert CliRunner().invoke(get, [str(file), "cloud.ply", str(target)]).exit_code == 0
    assert target.read_bytes() == b"ply\n" * 1000
