"""The test bed does what it says: else the tests that stand on it prove nothing."""

from __future__ import annotations

import contextlib
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from testbed.machine import Machine
from testbed.network import LAPTOP, Namespace, Network, Permission, TestBedError

StartMachine = Callable[..., Machine]

CONNECT = """
import socket, sys
try:
    with socket.create_connection((sys.argv[1], int(sys.argv[2])), 0.7) as connection:
        connection.settimeout(0.7)
        print(connection.recv(4).decode())
except OSError as error:
    print(type(error).__name__)
"""


def connect(prefix: list[str], address: str, port: int = 22) -> str:
    """Return the first bytes that an address says, or how the attempt ended."""
    done = subprocess.run(
        [*prefix, "/usr/bin/python3", "-c", CONNECT, address, str(port)],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_groups_judge_first_packets_only(network: Network, start_machine: StartMachine) -> None:
    one, other = start_machine(), start_machine()
    network.permit(
        [
            Permission(one.private, LAPTOP, "22"),
            Permission(other.private, one.private, "7000-7100"),
        ]
    )
    assert connect(network.laptop.prefix, one.public) == "SSH-"
    assert connect(network.laptop.prefix, other.public) == "TimeoutError"
    assert connect(one.prefix, other.private, 7070) == "ConnectionRefusedError"
    assert connect(one.prefix, other.private) == "TimeoutError"


def test_private_addresses_are_private(network: Network, start_machine: StartMachine) -> None:
    machine = start_machine()
    network.permit([Permission(machine.private, "0.0.0.0/0", "22")])
    assert connect(network.laptop.prefix, machine.private) == "TimeoutError"
    assert connect(machine.prefix, LAPTOP) == "TimeoutError"


def test_faults(network: Network, start_machine: StartMachine) -> None:
    machine = start_machine()
    network.permit([Permission(machine.private, LAPTOP, "22")])
    laptop = network.laptop.prefix
    network.cut(machine.private)
    assert connect(laptop, machine.public) == "TimeoutError"
    network.heal(machine.private)
    assert connect(laptop, machine.public) == "SSH-"
    machine.freeze()
    assert connect(laptop, machine.public) == "TimeoutError"
    machine.thaw()
    assert connect(laptop, machine.public) == "SSH-"
    machine.power_off()
    assert connect(laptop, machine.public) == "TimeoutError"  # nobody says that it is gone


def test_first_boot_installs_the_key_and_runs_user_data(start_machine: StartMachine) -> None:
    script = b"#!/bin/sh\necho ran as $(id -un) > /var/ran\necho hello > /dev/console\n"
    machine = start_machine(public_key=b"ssh-rsa AAAA me", user_data=script)
    assert machine.run("cat /var/ran") == "ran as root\n"
    assert machine.run("cat ~admin/.ssh/authorized_keys") == "ssh-rsa AAAA me"
    assert "hello\n" in machine.console()
    assert "-----BEGIN SSH HOST KEY KEYS-----\nssh-ed25519 " in machine.console().replace("\r", "")


def test_machine_without_sshd_refuses(network: Network, start_machine: StartMachine) -> None:
    machine = start_machine(has_sshd=False)
    network.permit([Permission(machine.private, LAPTOP, "22")])
    assert connect(network.laptop.prefix, machine.public) == "ConnectionRefusedError"


def test_shutdown_inside_is_seen_outside(start_machine: StartMachine) -> None:
    ended = threading.Event()
    machine = start_machine(on_power_off=lambda _: ended.set())
    with contextlib.suppress(TestBedError):  # this very command ends with the machine
        machine.run("sudo -u admin sudo shutdown -h now")
    assert ended.wait(30)
    assert not machine.is_on


def test_root_disk_is_thrown_away_and_bounded(start_machine: StartMachine) -> None:
    machine = start_machine(disk_mb=64)
    machine.run("echo x > /etc/testbed-was-here")
    assert not Path("/etc/testbed-was-here").exists()
    assert "No space left" in machine.run("head -c 80M /dev/zero 2>&1 > /home/admin/big || true")


def test_nothing_outlives_the_pipe() -> None:
    held = Namespace()
    network = Path(f"/proc/{held.pid}/ns/net").readlink()
    assert any_process_in(str(network))
    held.close()
    assert not any_process_in(str(network))


def any_process_in(network: str) -> bool:
    for link in Path("/proc").glob("[0-9]*/ns/net"):
        try:
            if str(link.readlink()) == network:
                return True
        except OSError:
            continue
    return False


@pytest.fixture(autouse=True)
def _needs_root(network: Network) -> None:
    """Skip all where there is no test bed."""
