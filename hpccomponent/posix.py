"""What not every system has: Windows lacks most of it, macOS some.

Who needs it asks here, so that a module can be imported wherever a wheel is installed. What has no
stand-in (fork, sessions, memory shared by name, sockets of the file system) is asked for where it
is used, and refused in words.
"""

from __future__ import annotations

import os
from typing import BinaryIO

try:
    import fcntl as fcntl
except ImportError:
    fcntl = None  # type: ignore[assignment]
try:
    import resource as resource
except ImportError:
    resource = None  # type: ignore[assignment]

MODULES = ("fcntl", "resource", "pwd", "termios")
"""Of the standard library, not everywhere."""
ADVICE = "on Windows work in WSL; serial and threads are the backends that run without"
"""What to do where something cannot be had."""
AT_ONCE = getattr(os, "O_NONBLOCK", 0)
"""To open a pipe without waiting for its other end."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
AS_BYTES = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""To open a file for this process alone, and no line end of it changed."""


def user_number() -> int:
    """Return the number of this user; 0 where users have none."""
    return os.geteuid() if hasattr(os, "geteuid") else 0


def block(descriptor: int) -> None:
    """Have reading and writing wait again after `AT_ONCE`."""
    if AT_ONCE:
        os.set_blocking(descriptor, True)


def reserve(file: BinaryIO, size: int) -> None:
    """Make a file so large; where the system can, a full disk says so here."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
    else:
        file.truncate(size)


def read_at(descriptor: int, size: int, start: int) -> bytes:
    """Return bytes of a file from a place on, fewer at its end; its position may change."""
    if hasattr(os, "pread"):
        return os.pread(descriptor, size, start)
    os.lseek(descriptor, start, os.SEEK_SET)
    return os.read(descriptor, size)


def read_into(descriptor: int, room: memoryview, start: int) -> int:
    """Read bytes of a file from a place on into memory; return how many, fewer at its end."""
    if hasattr(os, "preadv"):
        return os.preadv(descriptor, [room], start)
    taken = read_at(descriptor, len(room), start)
    room[: len(taken)] = taken
    return len(taken)


def write_at(descriptor: int, content: memoryview, start: int) -> int:
    """Write bytes to a place of a file; return how many the system has taken."""
    if hasattr(os, "pwrite"):
        return os.pwrite(descriptor, content, start)
    os.lseek(descriptor, start, os.SEEK_SET)
    return os.write(descriptor, content)
