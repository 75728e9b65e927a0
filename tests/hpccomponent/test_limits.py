"""What a process may use, read from made-up /proc and /sys trees and from the real one."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest
from made_up_machine import lay_out

from hpccomponent.limits import (
    available_cores,
    available_descriptors,
    available_memory,
    available_tasks,
    raise_descriptor_limit,
)


@pytest.fixture
def many_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(64)), raising=False)


def test_this_process_has_cores() -> None:
    assert 1 <= available_cores() <= (os.cpu_count() or 1)


def test_affinity_bounds_the_cores(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3, 5, 7}, raising=False)
    assert available_cores(tmp_path) == 3


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({"sys/fs/cgroup/a/b/cpu.max": "250000 100000"}, 2),
        (
            {"sys/fs/cgroup/a/b/cpu.max": "max 100000", "sys/fs/cgroup/a/cpu.max": "300000 100000"},
            3,
        ),
        ({"sys/fs/cgroup/a/b/cpu.max": "1000 100000"}, 1),
        ({"sys/fs/cgroup/cpu.max": "400000 100000"}, 4),
        ({"sys/fs/cgroup/unified/a/b/cpu.max": "500000 100000"}, 5),
        ({"sys/fs/cgroup/a/b/cpu.max": "max 100000"}, 64),
        ({"sys/fs/cgroup/a/b/cpu.max": "rubbish"}, 64),
    ],
)
@pytest.mark.usefixtures("many_cores")
def test_quota_of_cgroup_2_bounds_the_cores(
    tmp_path: Path, files: dict[str, str], cores: int
) -> None:
    root = lay_out(tmp_path, {"proc/self/cgroup": "0::/a/b\n", **files})
    assert available_cores(root) == cores


@pytest.mark.parametrize("mount", ["cpu", "cpu,cpuacct"])
@pytest.mark.parametrize("path", ["job/7", ""])
@pytest.mark.usefixtures("many_cores")
def test_quota_of_cgroup_1_bounds_the_cores(tmp_path: Path, mount: str, path: str) -> None:
    group = f"sys/fs/cgroup/{mount}/{path}"
    root = lay_out(
        tmp_path,
        {
            "proc/self/cgroup": "4:memory:/job/7\n3:cpu,cpuacct:/job/7\n1:name=systemd:/x\n",
            f"{group}/cpu.cfs_quota_us": "600000\n",
            f"{group}/cpu.cfs_period_us": "100000\n",
        },
    )
    assert available_cores(root) == 6


@pytest.mark.usefixtures("many_cores")
def test_no_quota_in_cgroup_1_is_no_bound(tmp_path: Path) -> None:
    root = lay_out(
        tmp_path,
        {
            "proc/self/cgroup": "3:cpu:/\n",
            "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "-1\n",
            "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000\n",
        },
    )
    assert available_cores(root) == 64


MEMINFO = {"proc/meminfo": "MemTotal:  9000 kB\nMemFree: 1 kB\nMemAvailable:  8000 kB\n"}


def test_this_process_has_memory() -> None:
    found = available_memory()
    assert found is None or found > 0.0


def test_memory_that_the_system_does_not_tell_is_not_known(tmp_path: Path) -> None:
    assert available_memory(tmp_path) is None


@pytest.mark.parametrize(
    ("groups", "left"),
    [
        ({}, 8_192_000),
        ({"a/memory.max": "max", "a/memory.current": "5"}, 8_192_000),
        ({"a/memory.max": "5000", "a/memory.current": "2000"}, 3000),
        ({"memory.max": "5000", "memory.current": "2000", "a/memory.max": "max"}, 3000),
        (
            {
                "a/memory.max": "5000",
                "a/memory.current": "4900",
                "a/memory.stat": "anon 900\nfile 4000\ninactive_file 3000\nactive_file 1000\n",
            },
            3100,
        ),
        ({"a/memory.max": "5000", "a/memory.current": "6000"}, 0),
        ({"a/memory.max": "5000"}, 8_192_000),
    ],
)
def test_the_least_of_machine_and_groups_of_version_2_is_left(
    tmp_path: Path, groups: dict[str, str], left: int
) -> None:
    files = {f"sys/fs/cgroup/{name}": text for name, text in groups.items()}
    root = lay_out(tmp_path, MEMINFO | {"proc/self/cgroup": "0::/a\n"} | files)
    assert available_memory(root) == left


def test_what_a_group_of_version_1_has_left(tmp_path: Path) -> None:
    files = {
        "proc/self/cgroup": "4:memory:/a\n",
        "sys/fs/cgroup/memory/a/memory.limit_in_bytes": "5000\n",
        "sys/fs/cgroup/memory/a/memory.usage_in_bytes": "4000\n",
        "sys/fs/cgroup/memory/a/memory.stat": "inactive_file 1\ntotal_inactive_file 500\n",
        "sys/fs/cgroup/memory/memory.limit_in_bytes": "9223372036854771712\n",
        "sys/fs/cgroup/memory/memory.usage_in_bytes": "4000\n",
    }
    assert available_memory(lay_out(tmp_path, MEMINFO | files)) == 1500


STATUS = "Name:\tx\nUid:\t{}\t0\t0\t0\nThreads:\t{}\n"


def test_the_processes_and_threads_of_a_user_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 1000)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (50, 60))
    files = {"proc/1/status": STATUS.format(0, 9), "proc/7/status": STATUS.format(1000, 3)}
    files["proc/8/status"] = STATUS.format(1000, 1)
    assert available_tasks(lay_out(tmp_path, files)) == (46, "'ulimit -u'")


def test_the_users_limit_does_not_bind_root(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (1, 1))
    assert available_tasks(tmp_path) is None


def test_a_control_group_bounds_processes_in_either_version(tmp_path: Path) -> None:
    files = {
        "proc/self/cgroup": "8:pids:/a\n",
        "sys/fs/cgroup/pids/a/pids.max": "100\n",
        "sys/fs/cgroup/pids/a/pids.current": "30\n",
        "sys/fs/cgroup/pids/pids.max": "max\n",
        "sys/fs/cgroup/pids/pids.current": "300\n",
    }
    found = available_tasks(lay_out(tmp_path, files))
    assert found is not None
    assert found[0] <= 70


@pytest.fixture
def low_soft_limit() -> Iterator[int]:
    """Lower the soft limit of open files to what is open and a few more."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    low = len(os.listdir("/dev/fd")) + 10
    resource.setrlimit(resource.RLIMIT_NOFILE, (low, before[1]))
    yield low
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_the_soft_limit_of_open_files_is_raised_to_what_is_needed(low_soft_limit: int) -> None:
    raise_descriptor_limit(1)
    assert resource.getrlimit(resource.RLIMIT_NOFILE)[0] == low_soft_limit
    raise_descriptor_limit(100)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert low_soft_limit < soft <= hard
    assert available_descriptors() >= 100
    raise_descriptor_limit(1 << 40)
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (hard, hard)
