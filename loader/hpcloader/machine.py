"""The facts of one machine that decide which worker build fits it.

Everything is read from files below `root`, so that tests can lay out a machine of their own.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Machine", "read_machine"]

_NVIDIA_SMI_WAIT_S = 10.0  # a driver in trouble can hang it for minutes


@dataclass(frozen=True, slots=True)
class Machine:
    """What a worker build may ask of a machine.

    Parameters
    ----------
    architecture : str
        As ``uname -m`` names it: ``x86_64``, ``aarch64``.
    cpu_flags : frozenset of str
        As in ``/proc/cpuinfo``: ``avx2``, ``asimd``; empty where there is none.
    cores : int
        How many this process may use: by affinity and by the quota of its control group.
    memory : int
        In bytes, the smaller of what is built in and what the control group allows.
    gpus : tuple of str
        Names of the GPUs.
    system, libc, python : str
        Name and version of the operating system, the C library and the interpreter.
    """

    architecture: str
    cpu_flags: frozenset[str]
    cores: int
    memory: int
    gpus: tuple[str, ...]
    system: str
    libc: str
    python: str


def read_machine(root: Path = Path("/")) -> Machine:
    """Read the facts of the machine this runs on.

    Parameters
    ----------
    root : Path
        Where ``proc`` and ``sys`` lie.

    Returns
    -------
    Machine
    """
    groups = list(_control_groups(root))
    return Machine(
        architecture=platform.machine(),
        cpu_flags=_cpu_flags(root),
        cores=_cores(groups),
        memory=_memory(root, groups),
        gpus=_gpus(root),
        system=f"{platform.system()} {platform.release()}",
        libc=" ".join(platform.libc_ver()).strip(),
        python=f"{platform.python_implementation()} {platform.python_version()}",
    )


def _text(path: Path) -> str:
    """Return the text of a file, or nothing where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _cpu_flags(root: Path) -> frozenset[str]:
    """Return the flags that every processor has; big and little cores may differ."""
    rows = [
        set(line.partition(":")[2].split())
        for line in _text(root / "proc/cpuinfo").splitlines()
        if line.partition(":")[0].strip() in ("flags", "Features")  # x86 and ARM
    ]
    return frozenset(set.intersection(*rows)) if rows else frozenset()


def _control_groups(root: Path) -> Iterator[Path]:
    """Yield the folders of this process's control groups and of all groups above them.

    A limit may sit on any level. Inside a container the path in ``/proc/self/cgroup`` is often
    the host's and not to be seen; then the mount itself is the container's group.
    """
    mounts = root / "sys/fs/cgroup"
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers:
            tops = [mounts / name for name in (controllers, *controllers.split(","))]
        else:
            tops = [mounts, mounts / "unified"]
        parts = [part for part in path.split("/") if part and part != ".."]
        for top in dict.fromkeys(tops):
            yield from (top.joinpath(*parts[:depth]) for depth in range(len(parts), -1, -1))


def _cores(groups: list[Path]) -> int:
    """Return how many cores this process may keep busy, at least one."""
    if hasattr(os, "sched_getaffinity"):
        cores = float(len(os.sched_getaffinity(0)))
    else:
        cores = float(os.cpu_count() or 1)
    for group in groups:
        quota_and_period = _text(group / "cpu.max").split() or [  # version 2, then version 1
            _text(group / "cpu.cfs_quota_us").strip(),
            _text(group / "cpu.cfs_period_us").strip(),
        ]
        if all(part.isdigit() for part in quota_and_period):  # "max" and -1 mean no limit
            quota, period = map(int, quota_and_period)
            cores = min(cores, quota / max(period, 1))
    return max(1, int(cores))


def _memory(root: Path, groups: list[Path]) -> int:
    """Return the bytes of memory this process may use."""
    memory = sys.maxsize
    for line in _text(root / "proc/meminfo").splitlines():
        if line.startswith("MemTotal:"):
            memory = int(line.split()[1]) * 1024
    if memory == sys.maxsize and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for group in groups:
        for name in ("memory.max", "memory.limit_in_bytes"):
            limit = _text(group / name).strip()
            if limit.isdigit():
                memory = min(memory, int(limit))
    return memory


def _gpus(root: Path) -> tuple[str, ...]:
    """Return the names of NVIDIA's GPUs, from the driver or else from its own tool."""
    names = [
        line.partition(":")[2].strip()
        for card in sorted((root / "proc/driver/nvidia/gpus").glob("*/information"))
        for line in _text(card).splitlines()
        if line.startswith("Model:")
    ]
    tool = shutil.which("nvidia-smi")
    if names or tool is None:
        return tuple(names)
    try:
        answer = subprocess.run(  # noqa: S603 - a fixed command line
            [tool, "--query-gpu=name", "--format=csv,noheader"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_NVIDIA_SMI_WAIT_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ()
    return tuple(line.strip() for line in answer.stdout.splitlines() if line.strip())
