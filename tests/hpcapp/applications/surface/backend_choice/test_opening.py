from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hpcapp
from hpcapp.applications.surface.backend_choice import cost_model as choice
from hpcapp.applications.surface.backend_choice import opening
from hpcapp.applications.surface.backend_choice.cost_model import Link, There
from hpcapp.applications.surface.job import run_job
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.settings import JobSettings
from hpcapp.backends.selection import open_executor
from hpcapp.io import read_points
from hpcapp.progress import SilentProgress


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let there be two cores, wherever this runs."""
    monkeypatch.setattr(opening, "available_cores", lambda: 2)


@pytest.fixture
def hopeful(monkeypatch: pytest.MonkeyPatch, two_cores: None) -> None:
    """Let workers pay if they are a thousand times slower, and wait for them as long."""
    monkeypatch.setattr(choice, "MARGIN", 1e-3)
    monkeypatch.setattr(opening, "PATIENCE", 1e3)


def run(points: Path, **options: Any) -> tuple[dict[str, Any], bytes]:
    output = points.parent / "mesh.ply"
    settings = JobSettings(points, str(output), grid=32, **options)
    return run_job(settings, SilentProgress()), output.read_bytes()


@pytest.mark.usefixtures("two_cores")
def test_a_small_cloud_starts_nothing(sphere_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_and_tell(name: str, **options: Any) -> Any:
        opened.append(name)
        return open_executor(name, **options)

    opened: list[str] = []
    monkeypatch.setattr(opening, "open_executor", open_and_tell)
    for workers in (None, 1, 4):
        report, _ = run(sphere_file, workers=workers)
        assert (report["backend"], report["workers"]) == ("serial", 1)
        told = report["choice"]
        assert (told["backend"], told["workers"], told["workers_asked"]) == ("serial", 1, workers)
        if workers == 1:
            assert "to be used" in told["reason"]
        else:
            assert "the start of workers" in told["reason"]
            assert told["local_s"] is told["distributed_s"] is None
    assert opened == ["serial"] * 3


@pytest.mark.usefixtures("two_cores")
def test_a_cloud_that_might_pay_is_measured(
    sphere_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "may_pay", lambda *_: True)
    report, _ = run(sphere_file)
    told = report["choice"]
    assert report["backend"] == told["backend"] == "serial"
    assert "with 2 workers" in told["reason"]
    assert 0.0 < told["local_s"] < told["distributed_s"]


def test_what_is_asked_for_is_not_chosen(sphere_file: Path) -> None:
    report, _ = run(sphere_file, backend="threads", workers=3)
    assert report["choice"] == {
        "backend": "threads", "workers": 3, "reason": "it was asked for", "local_s": None,
        "distributed_s": None, "bandwidth_mb_s": None, "workers_asked": 3,
    }  # fmt: skip
    report, _ = run(sphere_file, method=Paper(), workers=2)
    assert report["backend"] == "serial"
    assert "paper" in report["choice"]["reason"]


@pytest.mark.usefixtures("hopeful", "standing_helpers")
def test_workers_that_pay_are_started_and_measured(sphere_file: Path) -> None:
    _, alone = run(sphere_file, backend="serial")
    report, mesh = run(sphere_file, workers=4)
    assert (report["backend"], report["workers"]) == ("zmq", 2)  # there are no more cores
    assert report["choice"]["bandwidth_mb_s"] > 0.0
    assert mesh == alone
    cloud = read_points(sphere_file)
    assert cloud.normals is not None
    found = hpcapp.reconstruct(cloud.positions, cloud.normals, grid=32)
    again = hpcapp.reconstruct(cloud.positions, cloud.normals, grid=32, executor="serial")
    assert np.array_equal(found.vertices, again.vertices)


@pytest.mark.usefixtures("hopeful", "standing_helpers")
def test_workers_that_turn_out_slow_are_left_again(
    sphere_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "measure_workers", lambda *_: There((1e6,), Link(1.0, 1.0)))
    report, _ = run(sphere_file)
    assert (report["backend"], report["workers"], report["bytes_sent"]) == ("serial", 1, 0)
    assert "does not pay" in report["choice"]["reason"]


@pytest.mark.usefixtures("hopeful")
def test_a_clusters_workers_are_used_where_they_pay(
    sphere_file: Path, standing_cluster: Callable[..., Any]
) -> None:
    _, alone = run(sphere_file, backend="serial")
    report, mesh = run(sphere_file, cluster=standing_cluster().inventory)
    assert (report["backend"], report["workers"]) == ("cluster", 2)
    assert report["choice"]["bandwidth_mb_s"] > 0.0
    assert mesh == alone


@pytest.mark.parametrize("patience", [0.0, 1.0])
def test_a_cluster_is_not_waited_for_where_it_does_not_pay(
    patience: float,
    sphere_file: Path,
    standing_cluster: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if patience:
        monkeypatch.setattr(choice, "MARGIN", 1e-3)
        monkeypatch.setattr(opening, "PATIENCE", patience)
    report, _ = run(sphere_file, cluster=standing_cluster(running=0).inventory)
    assert (report["backend"], report["workers"]) == ("serial", 1)
    said = "did not come in time" if patience else "does not pay"
    assert said in report["choice"]["reason"]
