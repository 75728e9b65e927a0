"""``python bare_system.py 'VERB ...' 'VERB ...'``: commands where what Windows lacks is taken away.

Each is run in turn, and its exit code written.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
from importlib import import_module

MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "posix", "_posixsubprocess")
OF_OS = (
    "fork", "forkpty", "sysconf", "getuid", "geteuid", "getgid", "getegid", "killpg", "setsid",
    "getpgid", "posix_fallocate", "posix_spawn", "statvfs", "sched_getaffinity", "mkfifo", "uname",
    "getloadavg", "pread", "preadv", "pwrite", "pwritev", "fchmod", "fchown", "chown",
    "register_at_fork", "wait4", "waitid", "memfd_create", "O_NOFOLLOW", "O_NONBLOCK",
    "O_DIRECTORY", "O_CLOEXEC", "set_blocking", "WNOHANG",
)  # fmt: skip
OF_SIGNAL = (
    "SIGALRM", "SIGCHLD", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGUSR1", "SIGXCPU",
    "alarm", "pthread_kill", "pthread_sigmask", "setitimer", "sigwait",
)  # fmt: skip
LIBRARIES = (
    "asyncio", "concurrent.futures", "ctypes", "getpass", "gzip", "multiprocessing.shared_memory",
    "platform", "selectors", "subprocess", "tempfile", "uuid", "webbrowser",
    "click", "msgspec", "rich.progress", "scipy.spatial", "scipy.stats",
    "scipy.ndimage", "PIL.Image", "laspy",
)  # fmt: skip
"""They look at the system when they are imported, and find it whole."""


def take_away() -> None:
    """Leave what Windows has."""
    for name in LIBRARIES:
        import_module(name)
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]
    for module, names in ((os, OF_OS), (signal, OF_SIGNAL), (socket, ("AF_UNIX",))):
        for name in names:
            if hasattr(module, name):
                delattr(module, name)


def run(words: list[str]) -> int:
    """Run a command; return its exit code."""
    from hpcapp.cli import main

    try:
        main(words)
    except SystemExit as error:
        return int(error.code or 0)


if __name__ == "__main__":
    take_away()
    from hpcapp.interrupts import obey_signals

    obey_signals()
    for command in sys.argv[1:]:
        code = run(command.split())
        sys.stdout.write(f"\ncode {code} of {command}\n")
        sys.stdout.flush()
