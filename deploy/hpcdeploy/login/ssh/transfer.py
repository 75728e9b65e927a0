"""Files by commands of the machine: an interrupted one goes on, its SHA-256 checks the whole.

::

    put:  source ──stdin──> cat >>target.part ──checked──> target
    get:  tail -c +N source ──stdout──> .target.hpcapp-part ──checked──> target
"""

from __future__ import annotations

import hashlib
import os
import posixpath
import re
import shlex
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import BinaryIO

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import MOST_REASON, Completed, Shell, part_of, sha256_of

Progress = Callable[[int, int], None] | None
Feed = Callable[[str, Iterable[bytes], float], Completed]
Read = Callable[[str, float], Generator[bytes, None, None]]

_PIECE_S = 120.0  # a piece of a file that takes longer will never come
_SUM_S = 600.0
_CHUNK = 1 << 16
_SUM = """sha256sum -- "$f" 2>/dev/null || python3 -c '
import hashlib, sys
with open(sys.argv[1], "rb") as stream:
    print(hashlib.file_digest(stream, "sha256").hexdigest())' "$f"
"""
_SIZES = 'for f in {target} {part}; do echo "size=$([ -f "$f" ] && wc -c <"$f")"; done 2>/dev/null'
_SEND = """f={part}
mkdir -p -- {folder} && umask 077 || exit
[ ! -d {target} ] || {{ echo "it is a folder" >&2; exit 1; }}
{begin} -- "$f" && cat >>"$f" && sum=$({sum}) || exit
case $sum in *{digest}*) chmod {mode:o} -- "$f" && mv -f -- "$f" {target} && echo whole ;; esac
"""


def send_file(
    shell: Shell, feed: Feed, source: Path, target: str, mode: int, on_progress: Progress
) -> None:
    """Send a file; see `Shell.put`.

    `feed` runs a command on what it is given piece by piece; its seconds are for each piece, and
    for the command's end. Raises CloudError where the file cannot be read or written, or does not
    arrive as it was sent.
    """
    place = f"{source} -> {target}"
    names = {
        "target": shlex.quote(target),
        "part": shlex.quote(target + ".part"),
        "folder": shlex.quote(posixpath.dirname(target) or "."),
    }
    try:
        with source.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            size = stream.tell()
            target_size, part_size = _sizes(shell.run(_SIZES.format(**names)), 2)
            if target_size == size and _digest(shell, target) == digest:
                _check(shell, place, shell.run(f"chmod {mode:o} -- {names['target']}"))
                return
            for start in _starts(part_size, size):
                begin = "chmod 600" if start else "rm -f"
                send = _SEND.format(**names, begin=begin, sum=_SUM, digest=digest, mode=mode)
                done = feed(send, _pieces(stream, start, size, on_progress), _SUM_S)
                _check(shell, place, done)
                if done.output == "whole\n":
                    return
    except OSError as error:
        raise CloudError(f"{shell.node}: {place}: {error.strerror or error}") from error
    raise CloudError(f"{shell.node}: {target}: arrived damaged, twice", "try again")


def fetch_file(shell: Shell, read: Read, source: str, target: Path, on_progress: Progress) -> None:
    """Fetch a file; see `Shell.get`.

    `read` yields what a command writes; its seconds are for each piece. Raises CloudError where the
    file cannot be read or written, or does not arrive as it was sent.
    """
    place, part, file = f"{source} -> {target}", part_of(target), shlex.quote(source)
    counted = shell.run(f'size=$(wc -c <{file}) && echo "size=$size"')
    _check(shell, place, counted)
    size = _sizes(counted, 1)[0] or 0
    digest = _digest(shell, source)
    try:
        part_size = part.stat().st_size if part.exists() else None
        for start in _starts(part_size, size):
            done = start
            with (
                open(part, "ab" if start else "wb", opener=_open_own) as stream,
                closing(read(f"tail -c +{start + 1} -- {file}", _PIECE_S)) as pieces,
            ):
                for piece in pieces:
                    done += stream.write(piece[: size - done])
                    if on_progress is not None:
                        on_progress(done, size)
                    if done == size:
                        break
            if sha256_of(part) == digest:
                os.replace(part, target)
                return
    except OSError as error:
        raise CloudError(f"{shell.node}: {place}: {error.strerror or error}") from error
    raise CloudError(f"{shell.node}: {source}: arrived damaged, twice", "try again")


def _starts(part_size: int | None, size: int) -> list[int]:
    """Return where to begin: after what is held, and from the start if that was of another file."""
    return [part_size, 0] if part_size is not None and 0 < part_size <= size else [0]


def _pieces(stream: BinaryIO, start: int, size: int, on_progress: Progress) -> Iterator[bytes]:
    """Yield what a file has from `start` on, and tell of each piece that has been taken."""
    stream.seek(start)
    while piece := stream.read(_CHUNK):
        yield piece
        if on_progress is not None:
            on_progress(stream.tell(), size)


def _open_own(path: str, flags: int) -> int:
    """Open a file that is none yet, or was made so before: no link that somebody has put there."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)


def _sizes(done: Completed, count: int) -> list[int | None]:
    """Return the sizes that a machine has counted; None where there is no such file."""
    said = re.findall(r"^size=\s*([0-9]{0,19})$", done.output, re.MULTILINE)
    sizes = [int(text) if text else None for text in said]
    return [*sizes, *[None] * count][:count]


def _digest(shell: Shell, path: str) -> str:
    done = shell.run(f"f={shlex.quote(path)}; {_SUM}", timeout_s=_SUM_S)
    digests = re.findall(r"^\\?([0-9a-f]{64})\b", done.output, re.MULTILINE)
    if done.exit_code or not digests:
        last = (done.errors.strip().splitlines() or ["no sha256sum and no python3"])[-1]
        raise CloudError(f"{shell.node}: {path}: its checksum cannot be had ({last[:MOST_REASON]})")
    return str(digests[-1])


def _check(shell: Shell, place: str, done: Completed) -> None:
    if done.exit_code:
        raise CloudError(f"{shell.node}: {place}: {done.reason}")
