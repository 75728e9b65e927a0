"""The facts of one machine that decide which worker build fits it.

Everything is read from files below `root`, so that tests can lay out a machine of their own.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

from hpccomponent.dataclass import dataclass
from hpccomponent.limits import available_cores, control_groups, memory_limit, read_text

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
    system, libc, python : str
        Name and version of each.
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
    """Read the facts of the machine this runs on; ``proc`` and ``sys`` lie in `root`."""
    return Machine(
        architecture=platform.machine(),
        cpu_flags=_cpu_flags(root),
        cores=available_cores(root),
        memory=_memory(root),
        gpus=_gpus(root),
        system=f"{platform.system()} {platform.release()}",
        libc=" ".join(platform.libc_ver()).strip(),
        python=f"{platform.python_implementation()} {platform.python_version()}",
    )


def _cpu_flags(root: Path) -> frozenset[str]:
    """Return the flags that every processor has; big and little cores may differ."""
    rows = [
        set(line.partition(":")[2].split())
        for line in read_text(root / "proc/cpuinfo").splitlines()
        if line.partition(":")[0].strip() in ("flags", "Features")  # x86 and ARM
    ]
    return frozenset(set.intersection(*rows)) if rows else frozenset()


def _memory(root: Path) -> int:
    """Return the bytes of memory this process may use."""
    memory = sys.maxsize
    for line in read_text(root / "proc/meminfo").splitlines():
        if line.startswith("MemTotal:"):
            memory = int(line.split()[1]) * 1024
    if memory == sys.maxsize and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    limits = map(memory_limit, control_groups("memory", root))
    return min([memory, *(limit for limit in limits if limit is not None)])


def _gpus(root: Path) -> tuple[str, ...]:
    """Return the names of NVIDIA's GPUs, from the driver or else from its own tool."""
    names = [
        line.partition(":")[2].strip()
        for card in sorted((root / "proc/driver/nvidia/gpus").glob("*/information"))
        for line in read_text(card).splitlines()
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
