"""Machine facts, read from made-up /proc and /sys trees and from the real one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from made_up_machine import lay_out

from hpcloader import machine
from hpcloader.machine import read_machine


def test_this_machine_has_cores_and_memory() -> None:
    here = read_machine()
    assert here.cores >= 1
    assert here.memory > 2**24
    assert here.architecture
    assert here.python.split()[1].startswith("3.")


@pytest.mark.parametrize(
    ("cgroup", "limits", "memory"),
    [
        ("0::/a\n", {"sys/fs/cgroup/a/memory.max": "1048576\n"}, 2**20),
        ("0::/a\n", {"sys/fs/cgroup/a/memory.max": "max\n"}, 2**30),
        ("4:memory:/a\n", {"sys/fs/cgroup/memory/a/memory.limit_in_bytes": "2097152"}, 2**21),
        ("4:memory:/a\n", {"sys/fs/cgroup/memory/memory.limit_in_bytes": "4194304"}, 2**22),
        ("4:memory:/a\n", {"sys/fs/cgroup/memory/memory.limit_in_bytes": str(2**63)}, 2**30),
        ("0::/../../x\n", {"sys/fs/cgroup/memory.max": "1048576"}, 2**20),
    ],
)
def test_limits_of_control_groups_bound_the_memory(
    tmp_path: Path, cgroup: str, limits: dict[str, str], memory: int
) -> None:
    files = {"proc/meminfo": "MemTotal:  1048576 kB\nMemFree: 1 kB\n", "proc/self/cgroup": cgroup}
    assert read_machine(lay_out(tmp_path, files | limits)).memory == memory


def test_flags_are_those_that_all_processors_share(tmp_path: Path) -> None:
    cpuinfo = "processor : 0\nflags\t\t: sse avx avx2\n\nprocessor : 1\nflags\t\t: sse avx\n"
    root = lay_out(tmp_path, {"proc/cpuinfo": cpuinfo})
    assert read_machine(root).cpu_flags == {"sse", "avx"}


def test_flags_of_arm_are_read(tmp_path: Path) -> None:
    root = lay_out(tmp_path, {"proc/cpuinfo": "Features\t: fp asimd sve\n"})
    assert read_machine(root).cpu_flags == {"fp", "asimd", "sve"}


def test_gpus_are_read_from_the_driver(tmp_path: Path) -> None:
    cards = {
        f"proc/driver/nvidia/gpus/0000:0{n}/information": f"Model: \t NVIDIA {name}\nIRQ: 3\n"
        for n, name in enumerate(["H100", "L4"])
    }
    assert read_machine(lay_out(tmp_path, cards)).gpus == ("NVIDIA H100", "NVIDIA L4")


@pytest.mark.parametrize(
    ("script", "gpus"),
    [
        ("echo 'NVIDIA L4'; echo 'NVIDIA A2'", ("NVIDIA L4", "NVIDIA A2")),
        ("echo broken driver; exit 9", ()),
    ],
)
def test_gpus_are_else_asked_of_the_tool(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, gpus: tuple[str, ...]
) -> None:
    install_tool(tmp_path, monkeypatch, script)
    assert read_machine(tmp_path).gpus == gpus


def test_a_tool_that_hangs_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_tool(tmp_path, monkeypatch, "exec sleep infinity")
    monkeypatch.setattr(machine, "_NVIDIA_SMI_WAIT_S", 0.1)
    assert read_machine(tmp_path).gpus == ()


def install_tool(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Have ``nvidia-smi`` be a script."""
    tool = folder / "nvidia-smi"
    tool.write_text(f"#!/bin/sh\n{script}\n")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
