"""The first boot and the guard, run for real below a folder, with a `shutdown` that only tells."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from hpcdeploy.install.user_data import MAX_BYTES, user_data
from hpcdeploy.login.host_keys import parse_console
from hpcdeploy.spec.cluster import ClusterSpec

TIMEOUT_S = 30
IDLE_S = 900
LISTENING = "0100007F:1B9E 00000000:0000 0A"  # port 7070
CONNECTED_TO_HEAD = "0200000A:D431 0100000A:1B9E 01"
LOGIN = "0200000A:0016 0100000A:D431 01"
SSH_LISTENS = "00000000:0016 00000000:0000 0A"
CLOSING = "0100007F:1B9E 0100007F:D431 06"
KEY = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIGh0 root@vm"


def spec() -> ClusterSpec:
    image = {"image": {"id": "ami-1"}, "instance_type": "m5.large"}
    return ClusterSpec.model_validate(
        {
            "version": 1,
            "cluster": "bunny",
            "provider": {"type": "aws", "profiles": {"small": image}},
            "limits": {"idle": "15m"},
        }
    )


class Vm:
    """A machine that is a folder; `shutdown` and `sleep` are the test's own.

    The guard's `sleep` waits for the test to write a line: no time passes by itself.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in ("proc/net", "etc/ssh", "dev", "bin"):
            (root / folder).mkdir(parents=True)
        self.ticks = root / "ticks"
        os.mkfifo(self.ticks)
        self.asked = root / "asked"
        os.mkfifo(self.asked)
        (root / "etc/ssh/ssh_host_ed25519_key.pub").write_text(KEY + "\n")
        (root / "dev/console").touch()
        self.command("shutdown", f'echo "$@" >>{root}/shutdown')
        self.command("sleep", f"echo tick >{self.asked}; read -r line <{self.ticks}")
        self.command("curl", "exit 22")
        self.at(0.0)
        self.sockets()
        self.environment = {
            **os.environ,
            "PATH": f"{root}/bin:{os.environ['PATH']}",
            "HPCAPP_ROOT": str(root),
        }

    def command(self, name: str, text: str) -> None:
        path = self.root / "bin" / name
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)

    def at(self, uptime_s: float) -> None:
        (self.root / "proc/uptime").write_text(f"{uptime_s:.2f} 1.00\n")

    def sockets(self, *rows: str) -> None:
        lines = ["  sl  local_address rem_address   st", *(f"   0: {row}" for row in rows)]
        (self.root / "proc/net/tcp").write_text("\n".join(lines) + "\n")

    def boot(self, lease_until: float, market: str = "on_demand") -> None:
        until = datetime.fromtimestamp(lease_until, UTC)
        text = user_data(spec(), market, until).replace("setsid", "true #")
        subprocess.run(["sh", "-c", text], env=self.environment, check=True, timeout=TIMEOUT_S)
        self.guard = subprocess.Popen(
            ["sh", str(self.root / "var/lib/hpcapp/guard")], env=self.environment
        )

    def wait_for_round(self) -> None:
        """Wait until the guard has looked and sleeps."""
        assert self.asked.read_text() == "tick\n"

    def wake(self) -> None:
        self.ticks.write_text("go\n")

    def has_ended(self) -> bool:
        self.guard.wait(TIMEOUT_S)
        return (self.root / "shutdown").read_text() == "-h now\n"


@pytest.fixture
def vm(tmp_path: Path) -> Iterator[Vm]:
    vm = Vm(tmp_path)
    yield vm
    vm.guard.kill()
    vm.guard.wait()


def later(seconds: float) -> float:
    return time.time() + seconds


def test_the_host_keys_are_shown_on_the_console(vm: Vm) -> None:
    vm.boot(later(-1))
    assert vm.has_ended()
    console = (vm.root / "dev/console").read_text()
    assert parse_console(console) == [tuple(KEY.split()[:2])]


def test_a_lease_that_is_over_ends_the_machine(vm: Vm) -> None:
    vm.sockets(LISTENING)
    vm.boot(later(-1))
    assert vm.has_ended()


@pytest.mark.parametrize("rows", [(), (SSH_LISTENS,), (CLOSING,)])
def test_an_idle_machine_ends_after_its_time_and_not_before(vm: Vm, rows: tuple[str, ...]) -> None:
    vm.sockets(*rows)
    vm.boot(later(7200))
    vm.wait_for_round()
    vm.at(IDLE_S - 1.0)
    vm.wake()
    vm.wait_for_round()
    vm.at(IDLE_S)
    vm.wake()
    assert vm.has_ended()


@pytest.mark.parametrize("row", [LISTENING, CONNECTED_TO_HEAD, LOGIN])
def test_a_machine_in_use_stays_and_its_time_begins_anew(vm: Vm, row: str) -> None:
    vm.sockets(row)
    vm.boot(later(7200))
    for uptime_s in (5000.0, 6000.0):
        vm.wait_for_round()
        vm.at(uptime_s)
        vm.wake()
    vm.wait_for_round()
    vm.sockets()
    vm.at(6000.0 + IDLE_S - 1)
    vm.wake()
    vm.wait_for_round()
    vm.at(6000.0 + IDLE_S)
    vm.wake()
    assert vm.has_ended()


def test_the_lease_can_be_extended_and_half_written_limits_change_nothing(vm: Vm) -> None:
    vm.boot(later(7200))
    limits = vm.root / "var/lib/hpcapp/limits"
    for text in ("", "lease_until \nidle_s 9x", "lease_until 99999999999\nidle_s 7200\n"):
        vm.wait_for_round()
        limits.write_text(text)
        vm.wake()
    vm.wait_for_round()
    vm.at(7199.0)
    vm.wake()
    vm.wait_for_round()
    limits.write_text("lease_until 1\n")
    vm.wake()
    assert vm.has_ended()


def test_a_spot_machine_that_is_told_of_its_end_drains_its_worker(vm: Vm) -> None:
    loader = subprocess.Popen(["/bin/sleep", "600"])
    folder = vm.root / "home/admin/hpcapp/bunny"
    folder.mkdir(parents=True)
    (folder / "loader.pid").write_text(f"{loader.pid} 1\n")
    vm.command("getent", "echo admin:x:1:1::home/admin:/bin/sh")
    vm.command("systemctl", "exit 1")
    vm.command("curl", 'case $* in *spot/instance-action*) echo "{}" ;; *) echo token ;; esac')
    vm.boot(later(7200), "spot")
    assert loader.wait(TIMEOUT_S) == -15
    vm.wait_for_round()
    (vm.root / "var/lib/hpcapp/limits").write_text("lease_until 1\n")
    vm.wake()
    assert vm.has_ended()


def test_the_script_is_small_and_has_no_placeholder_left() -> None:
    text = user_data(spec(), "spot", datetime(2030, 1, 1, tzinfo=UTC))
    assert text.startswith("#!/bin/sh\n")
    assert len(text.encode()) < MAX_BYTES
    assert "@" not in text.replace("$@", "").partition("mkdir")[0]
