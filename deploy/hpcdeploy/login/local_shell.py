"""A shell on this very machine, whose home is a folder: what the local provider's nodes have."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from textwrap import shorten

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import Completed, Shell, part_of

_CHUNK = 1 << 20
_FRESH = os.O_WRONLY | os.O_CREAT | os.O_EXCL


class LocalShell(Shell):
    """Commands and files of a node that is a folder."""

    def __init__(self, node: str, home: Path) -> None:
        self.node = node
        self._home = home

    def run(self, command: str, *, stdin: bytes = b"", timeout_s: float = 60.0) -> Completed:
        """See `Shell.run`."""
        with self._start(command, subprocess.PIPE, subprocess.PIPE) as process:
            try:
                output, errors = process.communicate(stdin, timeout_s)
            except subprocess.TimeoutExpired:
                raise CloudError(
                    f"{self.node}: {shorten(command, 60)!r} did not end within {timeout_s:.0f} s"
                ) from None
            finally:
                _kill(process)
        return Completed(
            _exit_code(process.returncode),
            output.decode(errors="replace"),
            errors.decode(errors="replace"),
        )

    def follow(self, command: str, on_line: Callable[[str], None]) -> int:
        """See `Shell.follow`."""
        with self._start(command, subprocess.DEVNULL, subprocess.STDOUT) as process:
            assert process.stdout is not None  # noqa: S101 - for mypy
            try:
                for line in process.stdout:
                    on_line(line.decode(errors="replace").rstrip("\r\n"))
                process.wait()
            finally:
                _kill(process)
        return _exit_code(process.returncode)

    def interact(self, command: str = "") -> int:
        """See `Shell.interact`."""
        arguments = ["/bin/sh", "-c", command] if command else ["/bin/sh"]
        process = subprocess.run(  # noqa: S603 - it is the user's own command
            arguments, cwd=self._home, env=self._environment(), check=False
        )
        return _exit_code(process.returncode)

    def put(
        self,
        source: Path,
        target: str,
        *,
        mode: int = 0o600,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """See `Shell.put`."""
        self._copy(source, self._home / target, mode, on_progress)

    def get(
        self, source: str, target: Path, *, on_progress: Callable[[int, int], None] | None = None
    ) -> None:
        """See `Shell.get`."""
        self._copy(self._home / source, target, None, on_progress)

    def forward(self, address: str, port: int) -> int:
        """See `Shell.forward`."""
        del address
        return port

    def close(self) -> None:
        """Do nothing: there is no connection."""

    def _environment(self) -> dict[str, str]:
        return {**os.environ, "HOME": str(self._home)}

    def _start(self, command: str, stdin: int, stderr: int) -> subprocess.Popen[bytes]:
        try:
            return subprocess.Popen(  # noqa: S603 - what is to be run is the caller's say
                ["/bin/sh", "-c", command],
                cwd=self._home,
                env=self._environment(),
                stdin=stdin,
                stdout=subprocess.PIPE,
                stderr=stderr,
                start_new_session=True,
            )
        except OSError as error:
            raise CloudError(f"{self.node}: {self._home}: {error.strerror}") from error

    def _copy(
        self,
        source: Path,
        target: Path,
        mode: int | None,
        on_progress: Callable[[int, int], None] | None,
    ) -> None:
        """Copy a file, whole or not at all; without a mode as the user's own new files are."""
        fresh = 0o666 if mode is None else 0o600
        beside = part_of(target)
        try:
            total = source.stat().st_size
            target.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileNotFoundError):
                beside.unlink()
            with source.open("rb") as read, open(os.open(beside, _FRESH, fresh), "wb") as write:
                while chunk := read.read(_CHUNK):
                    write.write(chunk)
                    if on_progress is not None:
                        on_progress(write.tell(), total)
            if mode is not None:
                beside.chmod(mode)
            os.replace(beside, target)
        except OSError as error:
            with contextlib.suppress(OSError):
                beside.unlink()
            raise CloudError(
                f"{self.node}: {error.filename or target}: {error.strerror}"
            ) from error


def _exit_code(code: int) -> int:
    """Return an exit code as a shell says it."""
    return code if code >= 0 else 128 - code


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End what still runs, with all that it has started in the foreground."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
