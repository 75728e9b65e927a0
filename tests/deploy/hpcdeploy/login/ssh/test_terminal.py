"""A terminal on another machine, from a real one here, by a real OpenSSH server."""

from __future__ import annotations

import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
from machines.openssh import open_sshd

from hpcdeploy.login.ssh.target import SshTarget

RAW = termios.ICANON | termios.ECHO | termios.ISIG

# In a process of its own, which has the terminal to itself.
PROGRAM = """
import sys
from contextlib import ExitStack
from hpccomponent.errors import HpcError
from hpcdeploy.login.ssh.shell import SshShell
from hpcdeploy.login.ssh.connect import connect
from hpcdeploy.login.ssh.target import SshTarget

port, user, key, hosts, command = sys.argv[1:]
target = SshTarget("127.0.0.1", int(port), user, (key,), known_hosts=(hosts,))
with ExitStack() as closer:
    connection = connect(target, closer)
    with SshShell("head", connection, closer.pop_all()) as shell:
        try:
            sys.exit(shell.interact(command))
        except HpcError as error:
            print(error)
            sys.exit(error.exit_code)
"""


class Terminal:
    """A terminal, and the program on it."""

    def __init__(self, target: SshTarget, hosts: Path, command: str) -> None:
        self.keys, self.screen = pty.openpty()
        self.resize(33, 101)
        self.settings = termios.tcgetattr(self.screen)
        self.said = b""
        arguments = [str(target.port), target.user, target.key_files[0], str(hosts), command]
        self.program = subprocess.Popen(
            [sys.executable, "-P", "-c", PROGRAM, *arguments],
            stdin=self.screen,
            stdout=self.screen,
            stderr=self.screen,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
            env={**os.environ, "TERM": "vt100", "COLUMNS": "7", "LINES": "7"},  # of another window
        )

    def resize(self, rows: int, columns: int) -> None:
        fcntl.ioctl(self.keys, termios.TIOCSWINSZ, struct.pack("4H", rows, columns, 0, 0))

    def type(self, text: str) -> None:
        os.write(self.keys, text.encode())

    def wait_for(self, text: str) -> None:
        """Read what is shown until it shows a text."""
        while text.encode() not in self.said:
            self.said += os.read(self.keys, 1024)

    @property
    def is_raw(self) -> bool:
        return not termios.tcgetattr(self.screen)[3] & RAW

    @property
    def is_restored(self) -> bool:
        return termios.tcgetattr(self.screen) == self.settings

    def close(self) -> None:
        if self.program.poll() is None:
            self.program.kill()
        self.program.wait()
        os.close(self.keys)
        os.close(self.screen)


@pytest.fixture
def target(tmp_path: Path) -> Iterator[SshTarget]:
    with open_sshd(tmp_path) as target:
        yield target


@pytest.fixture
def hosts(target: SshTarget, tmp_path: Path) -> Path:
    path = tmp_path / "known_hosts"
    path.write_text(f"[127.0.0.1]:{target.port} {(tmp_path / 'host.pub').read_text()}")
    return path


def test_keys_and_the_size_of_the_window_go_there(target: SshTarget, hosts: Path) -> None:
    script = "trap 'echo interrupted; exit 7' INT; while stty size; do read line; done"
    terminal = Terminal(target, hosts, f'sh -c "{script}"')
    try:
        terminal.wait_for("33 101")
        assert terminal.is_raw
        terminal.resize(44, 88)
        terminal.type("\r")
        terminal.wait_for("44 88")
        terminal.type("\x03")
        terminal.wait_for("interrupted")
        assert terminal.program.wait(60) == 7
        assert terminal.is_restored
    finally:
        terminal.close()


def test_a_lost_connection_gives_the_terminal_back(target: SshTarget, hosts: Path) -> None:
    terminal = Terminal(target, hosts, "sh -c 'echo server=$PPID=; cat'")
    try:
        terminal.wait_for("=\r\n")
        assert terminal.is_raw
        os.kill(int(terminal.said.split(b"=")[1]), signal.SIGKILL)
        terminal.wait_for("head: the connection was lost")
        assert terminal.program.wait(60) == 4
        assert terminal.is_restored
    finally:
        terminal.close()
