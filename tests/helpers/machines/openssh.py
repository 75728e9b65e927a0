"""A real OpenSSH server on loopback, as whoever runs the tests."""

from __future__ import annotations

import getpass
import shlex
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import paramiko
import pytest

from hpcdeploy.login.ssh.target import SshTarget

SSHD = Path("/usr/sbin/sshd")
CONFIG = """
HostKey {folder}/host
AuthorizedKeysFile {folder}/login.pub
ListenAddress 127.0.0.1
Port {port}
PidFile none
StrictModes no
UsePAM no
PasswordAuthentication no
KbdInteractiveAuthentication no
ForceCommand {folder}/enter
"""


def start_sshd(folder: Path, home: Path) -> tuple[subprocess.Popen[bytes], int]:
    """Start a server; skip the test where that cannot be.

    Parameters
    ----------
    folder : Path
        Gets the keys: ``host`` and ``login``, each with its ``.pub``.
    home : Path
        Where logins begin, as on another machine.

    Returns
    -------
    server : subprocess.Popen
        To be terminated.
    port : int
    """
    if not SSHD.exists():
        pytest.skip("openssh-server is not installed")
    if not Path("/run/sshd").is_dir() and getpass.getuser() == "root":
        pytest.skip("/run/sshd, which sshd wants of root, is not there")
    for name in ("host", "login"):
        command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)]
        subprocess.run(command, check=True)
    place = shlex.quote(str(home))
    enter = folder / "enter"
    enter.write_text(f'#!/bin/sh\ncd {place} && HOME={place} eval "exec $SSH_ORIGINAL_COMMAND"\n')
    enter.chmod(0o755)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    (folder / "config").write_text(CONFIG.format(folder=folder, port=port))
    server = subprocess.Popen([SSHD, "-D", "-e", "-f", folder / "config"], stderr=subprocess.PIPE)
    assert server.stderr is not None
    for line in server.stderr:
        if b"listening" in line:
            return server, port
    server.communicate()
    pytest.skip("this sshd does not run here")


@contextmanager
def open_sshd(folder: Path) -> Iterator[SshTarget]:
    """Run a server whose keys and home are in a folder."""
    server, port = start_sshd(folder, folder)
    try:
        kind, text = (folder / "host.pub").read_text().split()[:2]
        entry = paramiko.hostkeys.HostKeyEntry.from_line(f"x {kind} {text}")
        assert entry is not None
        assert entry.key is not None
        yield SshTarget(
            "127.0.0.1", port, getpass.getuser(), (str(folder / "login"),), (entry.key,)
        )
    finally:
        server.terminate()
        server.communicate()
