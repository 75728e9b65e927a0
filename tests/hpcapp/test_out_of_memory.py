"""One of three machines has too little memory: the job ends with the mesh of any other.

A control group has the kernel kill whoever takes too much; a bound on the address space has every
allocation fail, which a task feels as an error of its own.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from fixture_types import StartCommand
from process_tree import are_gone
from spheres import make_sphere
from standing import StartCluster

from hpcapp.io import write_points
from hpccomponent.limits import control_groups, read_text

MEBIBYTE = 1 << 20
GROUPS = (60, 90, 120, 200)  # MiB
TOO_SMALL = 100  # for any of its tasks
SPACES = (120, 220)  # MiB, of which libraries map most
OPTIONS = ("--backend", "zmq", "--method", "hierarchical", "--grid", "256")


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sphere whose tiles take tens of MiB each."""
    path = tmp_path_factory.mktemp("cloud") / "sphere.ply"
    write_points(path, make_sphere(200_000))
    return path


@pytest.fixture(scope="module")
def known() -> dict[str, bytes]:
    """The mesh that the first test has found for the others."""
    return {}


Reconstruct = Callable[[Sequence[str]], None]


@pytest.fixture
def reconstruct(
    standing_cluster: StartCluster,
    start_command: StartCommand,
    cloud: Path,
    known: dict[str, bytes],
    tmp_path: Path,
) -> Reconstruct:
    """Mesh the scan on three machines, one of them short of memory, and compare."""

    def run(folder: str, before: Sequence[str]) -> bytes:
        machines = tmp_path / folder
        machines.mkdir()
        names = ("head", "worker-1", "worker-2")
        cluster = standing_cluster(folder=machines, names=names, before={"worker-1": before})
        job = ("reconstruct", str(cloud), "-o", "mesh.ply", *OPTIONS)
        with start_command(*job, "--cluster", str(cluster.inventory)) as process:
            said = process.communicate()[1]
        assert process.returncode == 0, said
        cluster.close()
        return (tmp_path / "mesh.ply").read_bytes()

    def compare(before: Sequence[str]) -> None:
        if not known:
            known["mesh"] = run("undisturbed", ())
        assert run("short", before) == known["mesh"]

    return compare


@pytest.fixture
def memory_group() -> Iterator[Path]:
    """A control group for memory, of either version, where one can be made."""
    for parent in control_groups("memory"):
        group = parent / f"hpc-test-{os.getpid()}"
        with contextlib.suppress(OSError):
            group.mkdir()
            break
    else:
        pytest.skip("control groups cannot be made here")
    try:
        yield group
    finally:
        # The last of its processes may be on their way out.
        assert are_gone({int(pid) for pid in (group / "cgroup.procs").read_text().split()})
        group.rmdir()


@pytest.mark.slow
@pytest.mark.parametrize("size", GROUPS)
def test_a_machine_whose_processes_are_killed_for_memory_costs_no_job(
    reconstruct: Reconstruct, memory_group: Path, size: int
) -> None:
    limits = [memory_group / name for name in ("memory.max", "memory.limit_in_bytes")]
    limit = next((path for path in limits if path.exists()), None)
    if limit is None:
        pytest.skip("this control group does not limit memory")
    limit.write_text(str(size * MEBIBYTE))
    enter = f'echo $$ > "{memory_group}/cgroup.procs"; exec "$@"'
    reconstruct(["sh", "-c", enter, "sh"])
    if size < TOO_SMALL:
        assert count_kills(memory_group) > 0


def count_kills(group: Path) -> int:
    """Return how many processes of a control group the kernel has killed for memory."""
    text = read_text(group / "memory.events") or read_text(group / "memory.oom_control")
    return sum(int(line.split()[1]) for line in text.splitlines() if line.startswith("oom_kill "))


@pytest.mark.slow
@pytest.mark.parametrize("size", SPACES)
def test_a_machine_whose_allocations_fail_costs_no_job(reconstruct: Reconstruct, size: int) -> None:
    reconstruct(["sh", "-c", f'ulimit -v {size * 1024}; exec "$@"', "sh"])
