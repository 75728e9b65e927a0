"""A machine of the test bed: namespaces of its own, a root disk that is thrown away, a real sshd.

Its first process reads from a pipe that the test holds, and ends with it. `boot`, `init` and
`first_boot` in the folder `image` are what runs in it, in this order.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from testbed.network import Namespace, Network, TestBedError, command

IMAGE = Path(__file__).parent / "image"
LOGIN = "admin"
LOGIN_ID = 1999
DISK_MB = 2048


def build_image(folder: Path) -> Path:
    """Lay out the files that turn the running system into an image with a login user."""
    system = folder / "usr/local/lib/testbed"
    system.mkdir(parents=True)
    for name in ("init", "first_boot"):
        shutil.copy(IMAGE / name, system / name)
    for name in ("shutdown", "poweroff", "halt"):
        (folder / "usr/local/sbin").mkdir(parents=True, exist_ok=True)
        shutil.copy(IMAGE / "shutdown", folder / "usr/local/sbin" / name)
        (folder / "usr/local/sbin" / name).chmod(0o755)
    (folder / "etc/ssh").mkdir(parents=True)
    shutil.copy(IMAGE / "sshd_config", folder / "etc/ssh/sshd_config")
    (folder / "etc/resolv.conf").write_text("")
    (folder / "etc/sudoers.d").mkdir()
    (folder / "etc/sudoers.d/testbed").write_text(
        f"Defaults !admin_flag\n{LOGIN} ALL=(ALL) NOPASSWD:ALL\n"
    )
    (folder / "etc/sudoers.d/testbed").chmod(0o440)
    for name, line, mode in (
        ("passwd", f"{LOGIN}:x:{LOGIN_ID}:{LOGIN_ID}::/home/{LOGIN}:/bin/sh\n", 0o644),
        ("group", f"{LOGIN}:x:{LOGIN_ID}:\n", 0o644),
        ("shadow", f"{LOGIN}:*:19000:0:99999:7:::\n", 0o640),
    ):
        (folder / "etc" / name).write_text(Path("/etc", name).read_text() + line)
        (folder / "etc" / name).chmod(mode)
    (folder / "home" / LOGIN).mkdir(parents=True)
    return folder


@dataclass
class Machine:
    """One machine.

    Parameters
    ----------
    name, private, public : str
        `public` may be empty.
    public_key, user_data : bytes
        What its metadata service hands out.
    metadata : dict of str to str
        More of it, by path below ``meta-data/``.
    disk_mb : int
        Of its root disk, in memory; 2^20 bytes.
    on_power_off : callable, optional
        Called where it ends by itself.
    on_line : callable, optional
        Called with every line that it prints on its console; sshd tells of each command there.
    """

    network: Network
    image: Path
    name: str
    private: str
    public: str = ""
    public_key: bytes = b""
    user_data: bytes = b""
    metadata: dict[str, str] = field(default_factory=dict)
    disk_mb: int = DISK_MB
    has_sshd: bool = True
    on_power_off: Callable[[Machine], None] | None = None
    on_line: Callable[[Machine, str], None] | None = None
    firmware: ClassVar[Path] = IMAGE / "boot"

    def __post_init__(self) -> None:
        self._cable: Namespace | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._printed = bytearray()
        self._said = threading.Condition()
        self._reader = threading.Thread(target=self._read_console, name=f"console of {self.name}")
        self._is_ended_by_us = False

    def start(self) -> None:
        """Switch the machine on."""
        self._cable = Namespace()
        self.network.plug(self._cable, self.private)
        self._process = subprocess.Popen(
            [*self._cable.prefix, "unshare", "--mount", "--uts", "--ipc", "--pid", "--fork",
             "--kill-child=KILL", "sh", str(self.firmware)],
            env=os.environ | {
                "IMAGE": str(self.image), "DISK_MB": str(self.disk_mb), "NAME": self.name,
                "SSHD": "1" if self.has_sshd else "0",
            },
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip
        self._reader.start()

    def _read_console(self) -> None:
        """Keep what the machine prints, until its last process is gone; then tell who asked."""
        assert self._process is not None
        assert self._process.stdout is not None
        with self._process.stdout as console:
            for line in console:
                with self._said:
                    self._printed += line
                    self._said.notify_all()
                if self.on_line:
                    self.on_line(self, line.decode(errors="replace").rstrip())
        self._process.wait()
        if not self._is_ended_by_us and self.on_power_off:
            self.on_power_off(self)

    def console(self) -> str:
        """Return what it has printed so far."""
        return self._printed.decode(errors="replace")

    def wait_for(self, text: str, timeout_s: float = 60.0) -> None:
        """Wait until the console says something."""
        with self._said:
            if not self._said.wait_for(lambda: text in self.console(), timeout_s):
                raise TestBedError(f"{self.name} never said {text!r}: {self.console()[-2000:]}")

    def wait_for_end(self, timeout_s: float = 60.0) -> None:
        """Wait until it has switched itself off, and the cloud knows."""
        self._reader.join(timeout_s)
        if self._reader.is_alive():
            raise TestBedError(f"{self.name} does not end: {self.console()[-2000:]}")

    @property
    def is_on(self) -> bool:
        """Whether its first process lives."""
        return self._process is not None and self._process.poll() is None

    def run(self, script: str) -> str:
        """Run a shell script as its root, past the network."""
        return command(*self.prefix, "sh", "-c", script)

    def freeze(self) -> None:
        """Stop every process but the first, as a machine that hangs."""
        self._signal_all(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let them go on."""
        self._signal_all(signal.SIGCONT)

    def power_off(self) -> None:
        """Pull the plug: the cable first, for a dead machine's kernel says no goodbye."""
        self._is_ended_by_us = True
        if self._process is None:
            return
        self.network.cut(self.private)
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._init_pid() or self._process.pid, signal.SIGKILL)
        self.close()

    def close(self) -> None:
        """Wait for the end and forget the machine."""
        self._is_ended_by_us = True
        if self._process is not None:
            assert self._process.stdin is not None
            self._process.stdin.close()
            if threading.current_thread() is not self._reader:  # `on_line` may pull the plug
                self._reader.join()
        if self._cable is not None:
            self._cable.close()
        self.network.forget(self.private)

    @property
    def prefix(self) -> list[str]:
        """What to put before a command that shall run in here as root, past the network."""
        init = self._init_pid()
        if init is None:
            raise TestBedError(f"{self.name} is off")
        return ["nsenter", "-t", str(init), "--all", "--"]

    def _init_pid(self) -> int | None:
        """Return its first process, seen from here: the only child of `unshare`."""
        if not self.is_on or self._process is None:
            return None
        pid = self._process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return int(children[0]) if children else None

    def _signal_all(self, number: signal.Signals) -> None:
        command(*self.prefix, "sh", "-c", f"kill -{int(number)} -1 || true")
