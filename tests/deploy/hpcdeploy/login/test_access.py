"""Logging in: real SSH servers in this process, and every way in which it can fail."""

from __future__ import annotations

import socket
import stat
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import paramiko
import pytest
from machines.servers import USER, Machines, Server
from simulated.memory import MemoryProvider

from hpccomponent.errors import CloudError
from hpcdeploy.login import access as access_module
from hpcdeploy.login.access import Access
from hpcdeploy.login.ssh.reach import LoginFault, ReachError
from hpcdeploy.login.ssh.target import jump_targets
from hpcdeploy.ownership.journal import open_journal
from hpcdeploy.provider import MachineSeen, State
from hpcdeploy.spec.cluster import ClusterSpec, Limits
from hpcdeploy.spec.layout import state_folder
from hpcdeploy.spec.names import NodeName
from hpcdeploy.spec.polling import utc_now


class Consoles(MemoryProvider):
    """A cloud whose machines are the test's servers."""

    def __init__(self) -> None:
        super().__init__()
        self.text: dict[str, str] = {}

    def console(self, machine: MachineSeen) -> str:
        return self.text.get(machine.id, "")


def cloud_spec(port: int, **auth: object) -> ClusterSpec:
    image = {"image": {"id": "ami-1"}, "instance_type": "m5.large"}
    return ClusterSpec.model_validate(
        {
            "version": 1,
            "cluster": "bunny",
            "provider": {"type": "aws", "profiles": {"small": image}},
            "auth": {"ssh_port": port, **auth},
        }
    )


def seen(server: Server, node: str = "worker-1") -> MachineSeen:
    return MachineSeen(
        f"i-{server.port}",
        "bunny",
        NodeName(node),
        "x",
        State.RUNNING,
        public_address=server.address,
    )


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(access_module, "RETRY_S", 0.01)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("HOME", str(tmp_path / "user"))


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    with Machines.open(tmp_path) as machines:
        yield machines


@pytest.fixture
def server(machines: Machines) -> Server:
    return machines.add()


@pytest.fixture
def cloud() -> Consoles:
    return Consoles()


@pytest.fixture
def access(server: Server, cloud: Consoles, tmp_path: Path) -> Iterator[Access]:
    access = Access(cloud_spec(server.port), tmp_path, cloud)
    server.keys.append(access.public_key())
    cloud.text[f"i-{server.port}"] = server.console
    yield access
    access.close()


def test_the_clusters_key_is_made_once_and_for_its_owner_only(access: Access) -> None:
    assert access.public_key() == access.public_key()
    assert access.public_key().startswith("ssh-rsa ")
    path = state_folder("bunny") / "id"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_a_machine_whose_console_shows_its_key_is_let_in(server: Server, access: Access) -> None:
    with access.open(seen(server)) as shell:
        assert shell.run("echo ready").output == "ready\n"


def test_a_key_stays_pinned_after_the_console_has_forgotten_it(
    server: Server, access: Access, cloud: Consoles
) -> None:
    access.open(seen(server))
    cloud.text.clear()
    access.open(seen(server))


def test_another_machines_host_key_is_refused_at_once(
    server: Server, access: Access, machines: Machines, cloud: Consoles
) -> None:
    other = machines.add()
    cloud.text[f"i-{server.port}"] = other.console
    with pytest.raises(CloudError, match=r"worker-1 \(i-\d+, 127.*not the pinned"):
        access.open(seen(server))


def test_a_machine_that_shows_no_key_is_waited_for_and_then_named(
    server: Server, access: Access, cloud: Consoles
) -> None:
    cloud.text[f"i-{server.port}"] = "kernel panic: no root\n"
    with pytest.raises(CloudError, match="host keys on its console") as caught:
        access.open(seen(server), timeout_s=0.05)
    assert caught.value.excerpt == "kernel panic: no root"
    assert server.commands == []


def test_permission_denied_right_after_boot_is_tried_again(server: Server, access: Access) -> None:
    server.denials = 2
    with access.open(seen(server)) as shell:
        assert shell.run("true").exit_code == 0


def test_permission_that_stays_denied_ends_the_waiting(
    server: Server, access: Access, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(access_module, "DENIED_S", 0.05)
    server.keys.clear()
    with pytest.raises(CloudError, match="refuses our key: permission denied"):
        access.open(seen(server))


def test_a_machine_that_refuses_is_named_with_the_reason(
    server: Server, access: Access, machines: Machines
) -> None:
    machines.stop(server)
    with pytest.raises(CloudError, match="connection refused"):
        access.open(seen(server), timeout_s=0.05)


@pytest.mark.parametrize("is_old", [False, True], ids=["set-up-before", "launched-long-ago"])
def test_a_machine_that_has_booted_once_is_not_waited_for_as_a_new_one(
    server: Server,
    machines: Machines,
    cloud: Consoles,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    is_old: bool,
) -> None:
    monkeypatch.setattr(access_module, "KNOWN_S", 0.2)
    monkeypatch.setattr(access_module, "TOLD_S", 0.01)
    caplog.set_level("INFO", "hpcapp")
    spec = cloud_spec(server.port)
    slow = spec.model_copy(update={"limits": Limits.model_validate({"boot": "1h"})})
    machine = replace(seen(server, "head"), launched=utc_now())
    machines.stop(server)
    if is_old:
        machine = replace(machine, launched=utc_now() - timedelta(days=1))
    else:
        with open_journal("bunny") as journal:
            journal.note_set_up([machine.id], is_done=True)
    access = Access(slow, tmp_path, cloud)
    access.public_key()
    cloud.text[machine.id] = server.console
    with pytest.raises(ReachError, match="refused"):
        access.open(machine)
    assert "head: waiting until it lets us in, 0 s at most" in caplog.text


def test_waiting_ends_when_the_cluster_is_closed(
    server: Server, access: Access, machines: Machines
) -> None:
    machines.stop(server)
    access.close()
    with pytest.raises(CloudError, match="no longer waited for"):
        access.open(seen(server))


def ssh_spec(server: Server, key: Path) -> ClusterSpec:
    return ClusterSpec.model_validate(
        {
            "version": 1,
            "cluster": "lab",
            "provider": {"type": "ssh", "hosts": [{"address": "lab1"}]},
            "auth": {"ssh_private_key": str(key)},
        }
    )


def host() -> MachineSeen:
    return MachineSeen("lab1", "lab", NodeName("head"), "x", State.RUNNING)


@pytest.fixture
def configured(server: Server, access: Access, tmp_path: Path) -> Iterator[Access]:
    """A user whose ssh configuration leads to the server."""
    folder = tmp_path / "user/.ssh"
    folder.mkdir(parents=True)
    (folder / "config").write_text(
        f"Host lab1\n  HostName {server.address}\n  Port {server.port}\n  User admin\n"
    )
    spec = ssh_spec(server, state_folder("bunny") / "id")
    access = Access(spec, tmp_path, MemoryProvider())
    yield access
    access.close()


def test_a_host_of_the_users_configuration_is_reached(
    server: Server, configured: Access, tmp_path: Path
) -> None:
    line = f"[{server.address}]:{server.port} {server.host_line}\n"
    (tmp_path / "user/.ssh/known_hosts").write_text(line)
    with configured.open(host()) as shell:
        assert shell.run("echo $HOME").output.strip() == str(server.home)


def test_a_host_that_the_user_has_never_seen_is_refused(configured: Access) -> None:
    with pytest.raises(
        CloudError, match=r"SHA256:\S+ of \S+ is not known; run ssh -p \d+ admin@lab1"
    ):
        configured.open(host())


def test_a_proxy_jump_is_followed(
    server: Server, machines: Machines, configured: Access, tmp_path: Path
) -> None:
    gate = machines.add()
    gate.keys += server.keys
    folder = tmp_path / "user/.ssh"
    with (folder / "config").open("a") as config:
        config.write(f"  ProxyJump admin@{gate.address}:{gate.port}\n")
    (folder / "known_hosts").write_text(
        "".join(f"[{s.address}]:{s.port} {s.host_line}\n" for s in (server, gate))
    )
    with configured.open(host()) as shell:
        assert shell.run("pwd").output.strip() == str(server.home)


@pytest.mark.parametrize(
    ("kind", "public", "found"),
    [
        ("auto", "203.0.113.7", "203.0.113.7"), ("auto", "", "10.0.0.7"),
        ("private", "203.0.113.7", "10.0.0.7"), ("public", "", ""),
    ],
)  # fmt: skip
def test_machines_are_reached_by_the_address_that_is_asked_for(
    kind: str, public: str, found: str
) -> None:
    machine = MachineSeen("i-1", "c", NodeName("head"), "life", State.RUNNING, public, "10.0.0.7")
    assert machine.address(kind) == found


@pytest.fixture
def bastion(machines: Machines, tmp_path: Path) -> Server:
    """A machine on the way that lets the user's own key in, and knows the cluster's not."""
    folder = tmp_path / "user/.ssh"
    folder.mkdir(parents=True)
    key = paramiko.RSAKey.generate(2048)
    key.write_private_key_file(str(folder / "id_rsa"))
    bastion = machines.add()
    bastion.keys.append(f"ssh-rsa {key.get_base64()}")
    return bastion


def know(server: Server, tmp_path: Path) -> None:
    line = f"[{server.address}]:{server.port} {server.host_line}\n"
    (tmp_path / "user/.ssh/known_hosts").write_text(line)


@pytest.fixture
def behind(
    server: Server, bastion: Server, cloud: Consoles, tmp_path: Path
) -> Iterator[tuple[Access, MachineSeen]]:
    """A cloud's machine whose address leads nowhere from here, only from the bastion."""
    jump = f"{USER}@{bastion.address}:{bastion.port}"
    access = Access(cloud_spec(server.port, ssh_proxy_jump=jump), tmp_path, cloud)
    server.keys.append(access.public_key())
    cloud.text[f"i-{server.port}"] = server.console
    bastion.routes["198.51.100.7"] = server.address  # of a network for documentation
    yield access, replace(seen(server), public_address="198.51.100.7")
    access.close()


def test_all_channels_of_a_clouds_machine_lead_over_the_bastion(
    behind: tuple[Access, MachineSeen], server: Server, bastion: Server, tmp_path: Path
) -> None:
    access, machine = behind
    know(bastion, tmp_path)
    with access.open(machine) as shell:
        assert shell.run("echo $HOME").output.strip() == str(server.home)
        lines: list[str] = []
        assert (shell.follow("echo one; echo two", lines.append), lines) == (0, ["one", "two"])
        (tmp_path / "file").write_bytes(b"points" * 10_000)
        shell.put(tmp_path / "file", "there")
        shell.get("there", tmp_path / "back")
        assert (tmp_path / "back").read_bytes() == (tmp_path / "file").read_bytes()
        with socket.create_server(("127.0.0.1", 0)) as listener:
            local = shell.forward(*listener.getsockname())
            with socket.create_connection(("127.0.0.1", local)) as near:
                far, _ = listener.accept()
                with far:
                    far.sendall(b"through")
                    assert near.recv(7, socket.MSG_WAITALL) == b"through"
    assert bastion.commands == []


def test_a_bastion_whose_host_key_is_unknown_is_not_passed(
    behind: tuple[Access, MachineSeen], bastion: Server, server: Server
) -> None:
    access, machine = behind
    with pytest.raises(ReachError) as caught:
        access.open(machine)
    assert caught.value.reach is LoginFault.HOST_KEY_UNKNOWN
    assert f"on the way, at {bastion.address}:{bastion.port}" in str(caught.value)
    assert server.commands == []


@pytest.mark.parametrize("jump", ["a b", "-oProxyCommand=x", "me@", "h:0", "h:99999", "a,b", "@h"])
def test_a_jump_that_is_none_is_refused(jump: str) -> None:
    with pytest.raises(ValueError, match=r"\[USER@\]HOST\[:PORT\]"):
        cloud_spec(22, ssh_proxy_jump=jump)


def test_jumps_may_be_several_and_have_ipv6_addresses(tmp_path: Path) -> None:
    spec = cloud_spec(22, ssh_proxy_jump=["gate", "me@[2001:db8::1]:2222"])
    places = [(jump.user, jump.place) for jump in jump_targets(spec.auth)]
    assert places == [("admin", "gate:22"), ("me", "[2001:db8::1]:2222")]
