"""A machine of the test bed whose first process is systemd, by systemd-nspawn."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import ClassVar

from testbed.machine import Machine

HIERARCHIES = [Path("/sys/fs/cgroup", name) for name in ("", "systemd", "unified")]


def missing() -> str:
    """Return why no such machine can be had here; nothing where one can."""
    if not shutil.which("systemd-nspawn"):
        return "no systemd-nspawn: systemd-container is not installed"
    if not Path("/usr/lib/systemd/systemd").exists():
        return "this system is not systemd's"
    return ""


class SystemdMachine(Machine):
    """One machine; its control groups are named after it."""

    firmware: ClassVar[Path] = Path(__file__).parents[2] / "systemd" / "image" / "boot"

    def close(self) -> None:
        """Wait for the end; a process that was left would keep its control group."""
        super().close()
        for hierarchy in HIERARCHIES:
            own = hierarchy / f"testbed-{self.name}"
            for folder in sorted(own.rglob("*/"), reverse=True) if own.exists() else []:
                folder.rmdir()
            if own.exists():
                own.rmdir()

    def _init_pid(self) -> int | None:
        """Return systemd, a child of the container's keeper; the firmware until it is there."""
        firmware = super()._init_pid()
        for keeper in _children(firmware):
            for child in _children(keeper):
                if Path(f"/proc/{child}/comm").read_text().strip() == "systemd":
                    return child
        return firmware


def _children(pid: int | None) -> list[int]:
    try:
        return [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []
