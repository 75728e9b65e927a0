"""Processes held by a CPU quota, and the CPU seconds that they took: control groups of Linux.

The quota of a group is refilled every 20 ms: within the system's default of 100 ms a process of
0.2 core may have to wait 80 ms before it answers a short message.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PERIOD_US = 20_000
ROOT = Path("/sys/fs/cgroup")
SHARES = 20  # times those of others, so that what a quota grants is had on a busy machine too


class CpuGroup:
    """A control group for the processes of one emulated machine.

    Parameters
    ----------
    name : str
        A path below the root of the hierarchies.
    cores : float or None
        How much it may take; None for all that there is.
    """

    def __init__(self, name: str, cores: float | None = None) -> None:
        self._folders = [root / name for root in _find_roots()]
        self._is_new = (ROOT / "cgroup.controllers").exists()  # version 2
        for folder in self._folders:
            folder.mkdir(parents=True)
        self._write("cpu.weight" if self._is_new else "cpu.shares", SHARES * self._default_shares)
        self.limit(cores)

    @property
    def _default_shares(self) -> int:
        return 100 if self._is_new else 1024

    def limit(self, cores: float | None) -> None:
        """Hold it to another quota."""
        quota = None if cores is None else round(cores * PERIOD_US)
        if self._is_new:
            self._write("cpu.max", f"{'max' if quota is None else quota} {PERIOD_US}")
            return
        self._write("cpu.cfs_quota_us", -1)  # or the kernel compares with the period before
        self._write("cpu.cfs_period_us", PERIOD_US)
        self._write("cpu.cfs_quota_us", -1 if quota is None else quota)

    @property
    def prefix(self) -> list[str]:
        """What to put before a command that shall run in here, all of its children too."""
        enter = "".join(f"echo $$ >{folder}/cgroup.procs; " for folder in self._folders)
        return ["sh", "-c", f'{enter}exec "$@"', "sh"]

    def used_s(self) -> float:
        """Return the CPU seconds of all that has run in here."""
        if self._is_new:
            lines = (self._folders[0] / "cpu.stat").read_text().splitlines()
            return 1e-6 * float(dict(line.split() for line in lines)["usage_usec"])
        return 1e-9 * float((self._folders[-1] / "cpuacct.usage").read_text())

    def is_empty(self) -> bool:
        """Whether no process is left."""
        return not (self._folders[0] / "cgroup.procs").read_text()

    def close(self) -> None:
        """Remove it; its processes must have ended."""
        for folder in self._folders:
            folder.rmdir()

    def _write(self, name: str, value: object) -> None:
        (self._folders[0] / name).write_text(str(value))


def missing() -> str:
    """Return why no group can be had here; nothing where one can."""
    if os.geteuid() != 0:
        return "CPU quotas need root"
    if not _find_roots():
        return "no control groups for the CPU here"
    name = f"hpcapp-probe-{os.getpid()}"
    try:
        with open_group(name, 0.5) as group:
            subprocess.run([*group.prefix, "true"], check=True, capture_output=True)
    except (OSError, subprocess.SubprocessError) as error:
        return f"no CPU quota can be set here: {error}"
    return ""


@contextmanager
def open_group(name: str, cores: float | None) -> Iterator[CpuGroup]:
    """Have a group for the time of a ``with`` block."""
    group = CpuGroup(name, cores)
    try:
        yield group
    finally:
        group.close()


def _find_roots() -> list[Path]:
    """Return where groups are made: one place, or one for the quota and one for the account."""
    controllers = ROOT / "cgroup.controllers"
    if controllers.exists():
        return [ROOT] if "cpu" in (ROOT / "cgroup.subtree_control").read_text().split() else []
    roots = [ROOT / "cpu", ROOT / "cpuacct"]
    if not all((root / "cgroup.procs").exists() for root in roots):
        return []
    return roots[:1] if roots[0].samefile(roots[1]) else roots
