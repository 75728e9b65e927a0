"""What of a machine this process may use: affinity, and limits of its user and control groups.

Files are read below `root`, so that tests can lay out a machine of their own.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from hpccomponent.posix import resource

_ROOT = Path("/")

_SHORTAGES = {errno.ENOMEM, errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.EIO}


def control_groups(controller: str, root: Path = _ROOT) -> Iterator[Path]:
    """Yield the folders of this process's control groups and of all groups above them.

    A limit may sit on any level. Inside a container the path in ``/proc/self/cgroup`` is often the
    host's and not to be seen; then the mount itself is the container's group. The controller is
    ``cpu``, ``memory`` or ``pids``; in version 2 groups limit everything.
    """
    mounts = root / "sys/fs/cgroup"
    for line in read_text(root / "proc/self/cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        names = controllers.split(",")
        if not controllers:
            tops = [mounts, mounts / "unified"]
        elif controller in names:
            tops = [mounts / name for name in (controllers, *names)]
        else:
            continue
        parts = [part for part in path.split("/") if part and part != ".."]
        for top in dict.fromkeys(tops):
            yield from (top.joinpath(*parts[:depth]) for depth in range(len(parts), -1, -1))


def available_cores(root: Path = _ROOT) -> int:
    """Return how many cores this process may keep busy: by affinity and by quota, at least one."""
    if hasattr(os, "sched_getaffinity"):
        cores = float(len(os.sched_getaffinity(0)))
    else:
        cores = float(os.cpu_count() or 1)
    for group in control_groups("cpu", root):
        quota_and_period = read_text(group / "cpu.max").split() or [  # version 2, then version 1
            read_text(group / "cpu.cfs_quota_us").strip(),
            read_text(group / "cpu.cfs_period_us").strip(),
        ]
        if all(part.isdigit() for part in quota_and_period):  # "max" and -1 mean no limit
            quota, period = map(int, quota_and_period)
            cores = min(cores, quota / max(period, 1))
    return max(1, int(cores))


def available_memory(root: Path = _ROOT) -> float | None:
    """Return the memory that can still be had, in bytes; None where the system does not say.

    Of the machine, and of each control group with a limit: what it holds of files that nobody has
    used lately is given back before anything else, and counts as free.
    """
    fields = _read_fields(root / "proc/meminfo")
    free = [1024.0 * fields["MemAvailable:"]] if "MemAvailable:" in fields else []
    for group in control_groups("memory", root):
        limit = memory_limit(group)
        used = read_text(group / "memory.current") or read_text(group / "memory.usage_in_bytes")
        if limit is not None and used.strip().isdigit():
            statistics = _read_fields(group / "memory.stat")
            idle = statistics.get("total_inactive_file", statistics.get("inactive_file", 0))
            free.append(max(0.0, float(limit - int(used) + idle)))
    return min(free, default=None)


def address_space_limit() -> int | None:
    """Return how many bytes of address space this process may have; None for no limit."""
    if resource is None:
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit


def available_descriptors() -> int:
    """Return how many more files, sockets and pipes this process may open, by its hard limit."""
    _, hard = _descriptor_limits()
    return max(0, hard - _count_open())


def raise_descriptor_limit(more: int) -> None:
    """Raise the soft limit of open files so that so many more can be opened, as far as may be."""
    if resource is None:
        return
    soft, hard = _descriptor_limits()
    wanted = min(hard, _count_open() + more)
    if wanted > soft:
        with contextlib.suppress(OSError, ValueError):  # what the system refuses stays as it was
            resource.setrlimit(
                resource.RLIMIT_NOFILE, (wanted, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
            )


def _descriptor_limits() -> tuple[int, int]:
    """Return the soft and the hard limit of open files; a great number for none."""
    if resource is None:
        return 1 << 30, 1 << 30
    soft, hard = (
        1 << 30 if limit == resource.RLIM_INFINITY else limit
        for limit in resource.getrlimit(resource.RLIMIT_NOFILE)
    )
    return soft, hard


def _count_open() -> int:
    """Return how many files are open; a guess where the system does not say."""
    for folder in ("/proc/self/fd", "/dev/fd"):
        with contextlib.suppress(OSError):
            return len(os.listdir(folder))
    return 16


def available_tasks(root: Path = _ROOT) -> tuple[int, str] | None:
    """Return how many more processes and threads there may be, and the limit that says so."""
    free: list[tuple[int, str]] = []
    if resource is not None and os.geteuid() != 0:  # no limit of users binds root
        user_limit, _ = resource.getrlimit(resource.RLIMIT_NPROC)
        if user_limit != resource.RLIM_INFINITY:
            free.append((user_limit - _count_tasks_of_user(root), "'ulimit -u'"))
    for group in control_groups("pids", root):
        limit = read_text(group / "pids.max").strip()
        used = read_text(group / "pids.current").strip()
        if limit.isdigit() and used.isdigit():
            free.append((int(limit) - int(used), "the control group's pids.max"))
    running = read_text(root / "proc/loadavg").partition("/")[2].partition(" ")[0]
    for name in ("threads-max", "pid_max"):
        limit = read_text(root / "proc/sys/kernel" / name).strip()
        if limit.isdigit() and running.isdigit():
            free.append((int(limit) - int(running), f"the kernel's {name}"))
    if not free:
        return None
    least, reason = min(free)
    return max(0, least), reason


def _count_tasks_of_user(root: Path) -> int:
    """Return how many processes and threads this process's user has."""
    user, count = str(os.getuid()), 0
    for status in (root / "proc").glob("[0-9]*/status"):
        text = read_text(status)
        fields = {line.partition(":")[0]: line.split()[1:] for line in text.splitlines()}
        if fields.get("Uid", [""])[0] == user:
            count += int(fields.get("Threads", ["1"])[0])
    return count


def total_memory(root: Path = _ROOT) -> int:
    """Return the machine's memory, or its control groups' lowest limit, in bytes; 0 if unknown."""
    limits = [memory_limit(group) for group in control_groups("memory", root)]
    sizes = [1024 * size for size in [_read_fields(root / "proc/meminfo").get("MemTotal:")] if size]
    return min([*sizes, *(limit for limit in limits if limit is not None)], default=0)


def memory_limit(group: Path) -> int | None:
    """Return the bytes that the processes of a control group may use; None for no limit."""
    for name in ("memory.max", "memory.limit_in_bytes"):  # version 2, then version 1
        limit = read_text(group / name).strip()
        if limit.isdigit():  # not "max"
            return int(limit)
    return None


def _read_fields(path: Path) -> dict[str, int]:
    """Return the numbers of a file of lines that begin with a name and a number."""
    lines = (line.split() for line in read_text(path).splitlines())
    return {words[0]: int(words[1]) for words in lines if len(words) > 1 and words[1].isdigit()}


def read_text(path: Path) -> str:
    """Return the text of a file, no UTF-8 replaced, or nothing where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def is_shortage(error: BaseException) -> bool:
    """Tell whether an error says that a machine lacks something, and not what the task did wrong.

    Memory, disk or open files have run out, or a disk is broken: another machine may have them.

    Examples
    --------
    >>> is_shortage(MemoryError()), is_shortage(OSError(errno.ENOSPC, "full"))
    (True, True)
    >>> is_shortage(FileNotFoundError(errno.ENOENT, "no such file"))
    False
    """
    return isinstance(error, MemoryError) or (
        isinstance(error, OSError) and error.errno in _SHORTAGES
    )
