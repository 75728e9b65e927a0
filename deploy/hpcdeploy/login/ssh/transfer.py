"""Files over SFTP: an interrupted one goes on, and the whole is checked by its SHA-256."""

from __future__ import annotations

import hashlib
import os
import posixpath
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Protocol

import paramiko

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import MOST_REASON, Shell, part_of, sha256_of

Progress = Callable[[int, int], None] | None

_CHUNK = 1 << 15  # what an SFTP server surely takes in one request
WINDOW = 1 << 28  # bytes that are asked for at once: the size is what the machine says it is
_DIGEST_S = 600.0
_DIGITS = 64  # of a SHA-256
_DIGEST = """f={file}; sha256sum -- "$f" 2>/dev/null || python3 -c '
import hashlib, sys
with open(sys.argv[1], "rb") as stream:
    print(hashlib.file_digest(stream, "sha256").hexdigest())' "$f"
"""


def send_file(
    shell: Shell,
    sftp: paramiko.SFTPClient,
    source: Path,
    target: str,
    mode: int,
    on_progress: Progress,
) -> None:
    """Send a file; see `Shell.put`.

    Raises
    ------
    CloudError
        The file cannot be read or written, or does not arrive as it was sent.
    """
    try:
        with source.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            size = stream.tell()
            if _size(sftp, target) == size and _remote_digest(shell, target) == digest:
                sftp.chmod(os.fsencode(target), mode)
                return
            _make_folder(shell, posixpath.dirname(target))
            part = target + ".part"
            is_whole = any(
                _send_from(shell, sftp, stream, part, start, size, on_progress) == digest
                for start in _starts(_size(sftp, part), size)
            )
    except OSError as error:
        raise _failed(shell, error, str(source), target) from error
    if not is_whole:
        raise CloudError(f"{shell.node}: {target}: arrived damaged, twice", "try again")
    sftp.chmod(os.fsencode(part), mode)
    sftp.posix_rename(os.fsencode(part), os.fsencode(target))


def fetch_file(
    shell: Shell, sftp: paramiko.SFTPClient, source: str, target: Path, on_progress: Progress
) -> None:
    """Fetch a file; see `Shell.get`.

    Raises
    ------
    CloudError
        The file cannot be read or written, or does not arrive as it was sent.
    """
    part = part_of(target)
    try:
        size = sftp.stat(os.fsencode(source)).st_size or 0
        digest = _remote_digest(shell, source)
        part_size = part.stat().st_size if part.exists() else None
        is_whole = any(
            _fetch_from(sftp, source, part, start, size, on_progress) == digest
            for start in _starts(part_size, size)
        )
        if is_whole:
            os.replace(part, target)
    except OSError as error:
        raise _failed(shell, error, source, str(target)) from error
    if not is_whole:
        raise CloudError(f"{shell.node}: {source}: arrived damaged, twice", "try again")


def _starts(part_size: int | None, size: int) -> list[int]:
    """Return where to begin: after what is held, and from the start if that was of another file."""
    return [part_size, 0] if part_size is not None and 0 < part_size <= size else [0]


def _send_from(
    shell: Shell,
    sftp: paramiko.SFTPClient,
    stream: BinaryIO,
    part: str,
    start: int,
    size: int,
    on_progress: Progress,
) -> str:
    """Send what comes after `start`; return the digest of all that lies there now."""
    stream.seek(start)
    with sftp.open(os.fsencode(part), "ab" if start else "wb") as remote:
        sftp.chmod(os.fsencode(part), 0o600)
        remote.set_pipelined(True)
        _copy(stream, remote, start, size, size, on_progress)
    return _remote_digest(shell, part)


def _fetch_from(
    sftp: paramiko.SFTPClient,
    source: str,
    part: Path,
    start: int,
    size: int,
    on_progress: Progress,
) -> str:
    with (
        sftp.open(os.fsencode(source), "rb") as remote,
        open(part, "ab" if start else "wb", opener=_open_own) as stream,
    ):
        remote.seek(start)
        done = start
        while done < size:
            end = min(size, done + WINDOW)
            remote.prefetch(end)
            done = _copy(remote, stream, done, end, size, on_progress)
            if done < end:
                break  # the file is shorter than was said
    return sha256_of(part)


class _Reader(Protocol):
    def read(self, size: int, /) -> bytes: ...


class _Writer(Protocol):
    def write(self, content: bytes, /) -> object: ...


def _copy(
    source: _Reader, target: _Writer, start: int, end: int, size: int, on_progress: Progress
) -> int:
    """Copy what lies from `start` to `end`, of a file of `size` bytes; return where it stops."""
    done = start
    while chunk := source.read(min(_CHUNK, end - done)):
        target.write(chunk)
        done += len(chunk)
        if on_progress is not None:
            on_progress(done, size)
    return done


def _open_own(path: str, flags: int) -> int:
    """Open a file that is none yet, or was made so before: no link that somebody has put there."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)


def _size(sftp: paramiko.SFTPClient, path: str) -> int | None:
    try:
        return sftp.stat(os.fsencode(path)).st_size
    except FileNotFoundError:
        return None


def _remote_digest(shell: Shell, path: str) -> str:
    done = shell.run(_DIGEST.format(file=shlex.quote(path)), timeout_s=_DIGEST_S)
    digests = re.findall(r"^\\?([0-9a-f]{64})\b", done.output, re.MULTILINE)
    if done.exit_code or not digests:
        last = (done.errors.strip().splitlines() or ["no sha256sum and no python3"])[-1]
        raise CloudError(f"{shell.node}: {path}: its checksum cannot be had ({last[:MOST_REASON]})")
    return str(digests[-1])


def _make_folder(shell: Shell, folder: str) -> None:
    if folder:
        done = shell.run(f"mkdir -p -- {shlex.quote(folder)}")
        if done.exit_code:
            raise CloudError(f"{shell.node}: {folder}: {done.reason}")


def _failed(shell: Shell, error: OSError, source: str, target: str) -> CloudError:
    """Say what failed; a server's bare "Failure" is most often a full disk."""
    place = f"{shell.node}: {source} -> {target}"
    if error.errno is None and str(error) == "Failure":
        free = shell.run("df -Ph . | tail -n 1").output.split()
        remaining = f"; {free[3]} are left on its disk" if len(free) > 3 else ""
        return CloudError(f"{place}: the machine cannot write it{remaining}", "make room there")
    return CloudError(f"{place}: {error.strerror or error}")
