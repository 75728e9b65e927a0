"""Table 1: one head that works and three workers, deployed from a cluster file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from hpcapp.backends.cluster import load_cluster_function
from hpcapp.io import read_mesh
from hpcapp.io.staging import replacing
from hpcapp.lab.reproduce.finding import Finding
from hpcapp.lab.reproduce.readings import STEP_1
from hpcapp.lab.reproduce.subject import Subject
from hpcapp.pages.render import render_mesh
from hpcapp.progress import StageClock
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError
from hpccomponent.foreign_json import convert

#: The machines of Table 1, emulated by folders of this machine.
LOCAL_CLUSTER = """\
# The machines of the paper's Table 1, each a folder with processes of its own on this machine.
version: 1
cluster: paper-table-1
provider: {type: local}
head: {component: true}       # VM 1: the HPC App and an HPC Component
workers: {count: 3}           # VM 2, 3 and 4: an HPC Component each
"""
_MACHINES = 4
_Count = Annotated[int, Meta(ge=0, lt=1 << 62)]


@dataclass(frozen=True, slots=True)
class _Figures:
    """What a head's report is asked for."""

    workers: _Count
    patches: _Count
    bytes_sent: _Count
    bytes_received: _Count
    stages: dict[str, Annotated[float, Meta(ge=0.0, le=1e12)]]


def write_local_cluster(path: Path) -> None:
    """Write the cluster file of the emulated machines; it appears whole or not at all."""
    with replacing(path) as file:
        file.write(LOCAL_CLUSTER.encode())


def make_table_1(
    subject: Subject, cluster: Path, grid: int, up: str, clock: StageClock, *, is_emulated: bool
) -> tuple[Finding, NDArray[np.uint8]]:
    """Deploy the machines of a cluster file, have them run the paper's method, and take them away.

    Machines that are up already stay up. The cluster is emulated where `write_local_cluster` wrote
    the file. Raise HpcError where it cannot be had, or the job has failed there.
    """
    run = load_cluster_function("run")
    target = subject.path.with_name("mesh.ply")
    words = ["--method", "paper", "--grid", str(grid), "--backend", "zmq", "--policy", "equal"]
    try:
        with clock.stage("deploy, reconstruct, take away"):
            answer = run(cluster, "reconstruct", subject.path, target, words)
        report = convert(answer, _Figures)
    except ValueError as error:
        raise JobError(f"the head's report lacks a figure ({error})", "run it again") from None
    finding = Finding(
        f"Table 1: {subject.name} on the machines of {cluster.name}",
        ("", "in the paper", "here"),
        _tabulate(report),
        f"{_compare(report.workers, cluster, is_emulated=is_emulated)} {STEP_1}.",
        "The mesh that came back, by the paper's method.",
    )
    return finding, render_mesh(read_mesh(target), size=800, up=up)


def _tabulate(report: _Figures) -> tuple[tuple[str, ...], ...]:
    stages = "; ".join(f"{name} {seconds:.2f}" for name, seconds in report.stages.items())
    return (
        ("VM 1", "HPC App and HPC Component", "head, which runs the job and a component"),
        ("VM 2 to VM 4", "an HPC Component each", "a worker with a component each"),
        ("components at work", str(_MACHINES), str(report.workers)),
        ("patches", "-", str(report.patches)),
        ("sent, received by the head, MB", "-",
         f"{report.bytes_sent / 1e6:.2f}, {report.bytes_received / 1e6:.2f}"),
        ("stages, s", "-", stages),
    )  # fmt: skip


def _compare(workers: int, cluster: Path, *, is_emulated: bool) -> str:
    if workers != _MACHINES:
        return (
            f"Not the paper's Table 1: {workers} components were at work in place of {_MACHINES}; "
            f"give {cluster.name} 'head: {{component: true}}' and 'workers: {{count: 3}}'."
        )
    if is_emulated:
        return (
            "The roles are the paper's; the machines are not: all four are folders of this "
            "machine and share its cores, where the paper has four virtual machines of a "
            "cloud."
        )
    return "The roles are the paper's; what the machines are is said by the cluster file."
