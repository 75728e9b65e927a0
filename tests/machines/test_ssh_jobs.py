"""Jobs on a head that SSH reaches: cut connections, and a cluster that goes while a job runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from heads import ON_WORKERS, WAITING, install_python, when_said, write_sphere
from machines.hosts import claim
from machines.servers import Machines, Server
from standing import StartCluster

from hpccomponent.errors import CloudError
from hpccomponent.inventory import hold_cluster
from hpcdeploy.jobs import cluster_job
from hpcdeploy.jobs.queries import open_jobs
from hpcdeploy.reconcile.cluster import open_cluster
from hpcdeploy.spec.job_folder import JobState

FOLDER = "hpcapp/lab"


@pytest.fixture
def held(
    file: Path, hosts: tuple[Server, Server], standing_cluster: StartCluster
) -> Iterator[Path]:
    """A cluster file whose head is set up, and held by another program: jobs get no further."""
    home = hosts[0].home / FOLDER
    install_python(home)
    inventory = standing_cluster(home, running=0).inventory
    with open_cluster(file) as cluster:
        claim(cluster)
    write_sphere(file.parent / "sphere.xyz")
    with hold_cluster(inventory, pytest.fail):
        yield file


def is_running(pid: int) -> bool:
    """Tell whether a process lives; one that only waits to be reaped does not."""
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


def test_a_job_outlives_a_cut_connection_and_is_attached_to_again(
    held: Path,
    hosts: tuple[Server, Server],
    machines: Machines,
    caplog: pytest.LogCaptureFixture,
) -> None:
    head = hosts[0]
    with open_cluster(held) as cluster, when_said(caplog, WAITING, lambda: machines.stop(head)):
        jobs = open_jobs(cluster)
        points = held.parent / "sphere.xyz"
        status = jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
        with pytest.raises(CloudError, match="connection was lost") as cut:
            cluster_job.watch(cluster, jobs, status)
    assert f"hpcapp attach {held} {status.job}" in str(cut.value)
    assert cut.value.exit_code == 4
    machines.start(head, head.port)
    with open_cluster(held) as cluster:
        jobs = open_jobs(cluster)
        assert jobs.find(status.job).state is JobState.RUNNING
        with when_said(caplog, WAITING, lambda: jobs.cancel(status.job)):
            status = cluster_job.watch(cluster, jobs, jobs.find(None))
        assert status.state is JobState.CANCELLED


def test_a_cluster_that_goes_ends_its_jobs_on_the_head(
    held: Path, hosts: tuple[Server, Server], caplog: pytest.LogCaptureFixture
) -> None:
    def take_away() -> None:
        with open_cluster(held) as other:
            other.provider.terminate(other.machines())

    with open_cluster(held) as cluster, when_said(caplog, WAITING, take_away):
        jobs = open_jobs(cluster)
        points = held.parent / "sphere.xyz"
        status = jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
        runner = jobs.find(status.job).runner
        status = cluster_job.watch(cluster, jobs, status)
    assert status.state is JobState.CANCELLED
    assert not is_running(runner)
    assert not (hosts[0].home / "hpcapp").exists()
