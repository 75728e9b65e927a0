"""A machine as seen by who sets it up: commands and files."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, Self

from hpccomponent.dataclass import dataclass

MOST_REASON = 500
"""Characters of what a machine says that stand in a message: it may say anything."""


@dataclass(frozen=True, slots=True)
class Completed:
    """A command that has ended; its `exit_code` is a shell's, 128 and its number for a signal."""

    exit_code: int
    output: str
    errors: str

    @property
    def reason(self) -> str:
        """The last line that it wrote to stderr, or the beginning of it; never empty."""
        lines = self.errors.strip().splitlines()
        return lines[-1].strip()[:MOST_REASON] if lines else f"exit code {self.exit_code}"


class Shell(Protocol):
    """Commands and files on one machine, in the login user's home.

    Paths of the machine are text, relative to the home. Every method raises `CloudError` with the
    machine's name and the reason where the machine cannot be reached.
    """

    node: str

    def run(self, command: str, *, stdin: bytes = b"", timeout_s: float = 60.0) -> Completed:
        """Run a POSIX shell command to its end; past `timeout_s` seconds raise CloudError."""
        ...

    def follow(self, command: str, on_line: Callable[[str], None]) -> int:
        """Run a command, hand over every line of its output as it comes, return its exit code.

        `on_line` takes a line of output or errors, without its end.
        """
        ...

    def interact(self, command: str = "") -> int:
        """Give the user's terminal to a command, a login shell if empty; return its exit code."""
        ...

    def put(
        self,
        source: Path,
        target: str,
        *,
        mode: int = 0o600,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Send a file: what is there already goes on, and the whole is checked by its SHA-256.

        `mode` is the target's permission bits; `on_progress` is told (bytes sent, bytes in all).
        """
        ...

    def get(
        self, source: str, target: Path, *, on_progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Fetch a file, in the same manner; `on_progress` is told (bytes fetched, bytes in all)."""
        ...

    def forward(self, address: str, port: int) -> int:
        """Forward a local port on loopback to an address the machine reaches; return the port.

        `address` is as the machine names it.
        """
        ...

    def close(self) -> None:
        """End the connection."""
        ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def part_of(target: Path) -> Path:
    """Return where a file lies here until all of it has come: a name that no user's file has."""
    return target.with_name(f".{target.name}.hpcapp-part")


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
