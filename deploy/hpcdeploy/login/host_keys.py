"""The pinned host keys of a cluster's machines: read from their consoles, never from the network.

A cloud's console is reached by the cloud's own signed API, so that nobody between this machine
and the other can put a key of theirs in its place. Keys are kept under the machine's id, because
addresses are given to other machines later.
"""

from __future__ import annotations

import os
import re
import threading
from pathlib import Path

import paramiko

from hpccomponent.errors import CloudError

_BEGIN, _END = "-----BEGIN SSH HOST KEY KEYS-----", "-----END SSH HOST KEY KEYS-----"
_KEY = re.compile(r"\b(ssh-ed25519|ssh-rsa|ecdsa-sha2-nistp\d+) +(AAAA[\w+/]+={0,2})")


def parse_console(text: str) -> list[tuple[str, str]]:
    """Return the host keys that a machine has printed on its console, each as its type and the key.

    They are as in a ``known_hosts`` file. What is between the marks that cloud-init uses counts;
    the kernel and the init system may have put their own words before each line.

    Examples
    --------
    >>> parse_console('''-----BEGIN SSH HOST KEY KEYS-----
    ... [  12.1] ssh-ed25519 AAAAC3Nz root@ip-10-0-0-1
    ... -----END SSH HOST KEY KEYS-----''')
    [('ssh-ed25519', 'AAAAC3Nz')]
    """
    blocks = (part.partition(_END) for part in text.split(_BEGIN)[1:])
    printed_keys = (
        match.groups() for block, end, _ in blocks if end for match in _KEY.finditer(block)
    )
    return list(dict.fromkeys((kind, key) for kind, key in printed_keys))


class HostKeys:
    """A ``known_hosts`` file of a cluster, which need not exist; safe in several threads."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()

    def find(self, machine_id: str) -> list[paramiko.PKey]:
        """Return the keys that are pinned for a machine.

        Raises CloudError where the file cannot be read.
        """
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines()
        except FileNotFoundError:
            return []
        except (OSError, UnicodeDecodeError) as error:
            raise CloudError(
                f"{self.path}: the pinned host keys cannot be read ({error})"
            ) from error
        entries = [paramiko.hostkeys.HostKeyEntry.from_line(line) for line in lines if line.strip()]
        return [
            entry.key
            for entry in entries
            if entry is not None and machine_id in entry.hostnames and entry.key is not None
        ]

    def pin(self, machine_id: str, keys: list[tuple[str, str]]) -> None:
        """Write down a machine's keys, each as its kind and the key in base64."""
        lines = "".join(f"{machine_id} {kind} {key}\n" for kind, key in keys)
        with self._lock:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
            with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
                stream.write(lines)
