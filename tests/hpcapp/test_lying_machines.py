"""Whole jobs on three machines of which one gives wrong answers that look right."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Future
from itertools import cycle, product
from pathlib import Path
from typing import Any

import pytest
from lies import LIES
from lying_tasks import TASKS
from standing import StandingCluster, StartCluster

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.backends.selection import open_executor
from hpcapp.communicator.scheduling.verification import Verification, attempt, repeat_until_trusted
from hpcapp.io import write_points
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import SHAPES
from hpcapp.progress import Progress
from hpccomponent.errors import InputError

HELPERS = Path(__file__).parents[1] / "helpers"
WHERE: dict[str, dict[str, Any]] = {"memory": {}, "folder": {"max_memory": 2.2e8}}


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "scan.ply"
    write_points(path, simulate_scan(SHAPES["torus"], ScanSettings(points=6000, noise=0.002)))
    return path


@pytest.fixture(scope="module")
def truth(scan: Path) -> bytes:
    mesh = scan.with_name("truth.ply")
    run_job(JobSettings(points=scan, output=str(mesh), backend="serial"), Progress())
    return mesh.read_bytes()


@pytest.fixture
def lying_cluster(standing_cluster: StartCluster, monkeypatch: pytest.MonkeyPatch) -> StartCluster:
    """Give a function that starts three machines of which the last tells a lie."""

    def start(lie: str, about: str = "all") -> StandingCluster:
        monkeypatch.setenv("PYTHONPATH", str(HELPERS))
        monkeypatch.setenv("LIE", lie)
        monkeypatch.setenv("LIE_ABOUT", about)
        return standing_cluster(names=("head", "worker-1", "liar"), tasks={"liar": TASKS})

    return start


def reconstruct(
    scan: Path, folder: Path, cluster: StandingCluster, where: str, verify: float | None
) -> tuple[bytes, dict[str, Any]]:
    more = {"temp_dir": str(folder / "temp"), **WHERE[where]} if WHERE[where] else {}
    mesh = folder / "mesh.ply"
    settings = JobSettings(
        points=scan,
        output=str(mesh),
        cluster=cluster.inventory,
        backend="zmq",
        verify=verify,
        report=folder / "page.html",
        **more,
    )
    report = run_job(settings, Progress())
    assert not more or not list((folder / "temp").iterdir())
    found = report["verification"]
    page = (folder / "page.html").read_text()
    assert f"verified {found['verified']}, unverified" in page
    return mesh.read_bytes(), found


def check_lie(
    scan: Path,
    truth: bytes,
    folder: Path,
    cluster: StandingCluster,
    where: str,
    verify: float | None,
) -> dict[str, Any]:
    mesh, found = reconstruct(scan, folder, cluster, where, verify)
    assert mesh == truth
    assert all("liar works for this job no more" in told for told in found["liars"])
    return found


def test_a_number_that_is_off_by_a_thousandth_is_found_where_all_is_verified(
    scan: Path, truth: bytes, tmp_path: Path, lying_cluster: StartCluster
) -> None:
    cluster = lying_cluster("times 1.001", "mesh_tile")
    found = check_lie(scan, truth, tmp_path, cluster, "memory", 1.0)
    assert len(found["liars"]) == 1
    assert found["disagreements"]
    assert not found["repeats"]  # no answer of it had been used


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("delay_s", [0, 4])
def test_a_liar_that_comes_again_under_other_names_has_one_opinion(
    scan: Path,
    truth: bytes,
    tmp_path: Path,
    standing_cluster: StartCluster,
    monkeypatch: pytest.MonkeyPatch,
    delay_s: int,
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(HELPERS))
    tasks = ",".join(TASKS)
    liar = [sys.executable, "-m", "renaming_liar", "connection.json", tasks]
    cluster = standing_cluster(
        names=("head", "slow", "liar"),
        tasks={"slow": TASKS},
        before={
            "slow": ["env", f"DELAY_S={delay_s}"],
            "liar": ["env", "LIE=times 1.001", "LIE_ABOUT=mesh_tile", *liar],
        },
    )
    found = check_lie(scan, truth, tmp_path, cluster, "memory", 1.0)
    assert len(found["liars"]) == bool(found["disagreements"])


def test_what_the_next_task_finds_impossible_is_laid_to_who_made_it(
    standing_cluster: StartCluster,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(HELPERS))
    names = ("head", "worker-1", "liar")
    tasks = {name: ["pair.make=lying_tasks:make_pair"] for name in names[:2]}
    tasks["liar"] = ["pair.make=lying_tasks:make_no_pair"]
    use = ["pair.use=lying_tasks:use_pair"]
    cluster = standing_cluster(names=names, tasks={name: tasks[name] + use for name in names})
    verification = Verification(1e-9)  # on, and it draws no answer before the next task has it

    def run(is_first: bool) -> list[float]:
        del is_first
        known = ["pair.make=lying_tasks:make_pair", *use]
        opened = open_executor(
            str(cluster.inventory),
            policy="equal",  # so that the liar has its share, however slow it is
            verification=verification,
            extra_tasks=known,
        )
        with opened as backend, attempt(verification):
            submit: Callable[..., Future[float]] = backend.executor.submit
            made = [submit("pair.make", float(number)) for number in range(60)]
            used = [submit("pair.use", future.result(60)) for future in made]
            return [future.result(60) for future in used]

    assert repeat_until_trusted(verification, run) == [0.0] * 60
    assert "is no pair" in verification.repeats[0]
    assert verification.liars.keys() == {"liar"}
    assert "the work begins anew: every answer is verified" in caplog.text


def test_honest_machines_agree_on_every_answer(
    scan: Path, truth: bytes, tmp_path: Path, standing_cluster: StartCluster
) -> None:
    cluster = standing_cluster(names=("head", "worker-1", "worker-2"))
    found = check_lie(scan, truth, tmp_path, cluster, "folder", 1.0)
    assert found["verified"] > 5
    assert not found["disagreements"]


def test_an_error_of_the_job_itself_comes_again_and_is_told(
    scan: Path,
    tmp_path: Path,
    standing_cluster: StartCluster,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(HELPERS))
    names = ("head", "worker-1", "worker-2")
    failing = ["surface.mesh_tile=lying_tasks:fail"]
    cluster = standing_cluster(names=names, tasks=dict.fromkeys(names, failing))
    with pytest.raises(InputError, match="no use for these"):
        reconstruct(scan, tmp_path, cluster, "memory", None)
    assert caplog.text.count("the work begins anew: every answer is verified") == 1
    assert not (tmp_path / "mesh.ply").exists()


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("lie", "how"), list(zip(LIES, cycle(product(WHERE, [None, 1.0])))))
def test_no_lie_about_all_tasks_changes_the_mesh(
    scan: Path,
    truth: bytes,
    tmp_path: Path,
    lying_cluster: StartCluster,
    lie: str,
    how: tuple[str, float | None],
) -> None:
    check_lie(scan, truth, tmp_path, lying_cluster(lie), *how)
