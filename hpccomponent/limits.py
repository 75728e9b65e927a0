"""What of a machine this process may use: affinity, and the limits of its control groups.

Files are read below `root`, so that tests can lay out a machine of their own.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

__all__ = [
    "available_cores",
    "available_memory",
    "control_groups",
    "memory_limit",
    "read_text",
    "total_memory",
]

_ROOT = Path("/")


def control_groups(controller: str, root: Path = _ROOT) -> Iterator[Path]:
    """Yield the folders of this process's control groups and of all groups above them.

    A limit may sit on any level. Inside a container the path in ``/proc/self/cgroup`` is often
    the host's and not to be seen; then the mount itself is the container's group.

    Parameters
    ----------
    controller : str
        ``cpu`` or ``memory``: what the groups limit; in version 2 they limit everything.
    root : Path
        Where ``proc`` and ``sys`` lie.
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
    """Return how many cores this process may keep busy: by affinity and by quota, at least one.

    Parameters
    ----------
    root : Path
        Where ``proc`` and ``sys`` lie.
    """
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

    Parameters
    ----------
    root : Path
        Where ``proc`` and ``sys`` lie.
    """
    fields = _read_fields(root / "proc/meminfo")
    free = [1024.0 * fields["MemAvailable:"]] if "MemAvailable:" in fields else []
    for group in control_groups("memory", root):
        limit = memory_limit(group)
        used = read_text(group / "memory.current") or read_text(group / "memory.usage_in_bytes")
        if limit is not None and used.strip().isdigit():
            told = _read_fields(group / "memory.stat")
            idle = told.get("total_inactive_file", told.get("inactive_file", 0))
            free.append(max(0.0, float(limit - int(used) + idle)))
    return min(free, default=None)


def total_memory(root: Path = _ROOT) -> int:
    """Return the memory that there is for this process, used or not, in bytes.

    That of the machine, or the lowest limit of its control groups; 0 where nothing is known.

    Parameters
    ----------
    root : Path
        Where ``proc`` and ``sys`` lie.
    """
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
    """Return the text of a file, or nothing where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
