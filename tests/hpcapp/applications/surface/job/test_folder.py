"""Who goes through a cloud in a folder."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import ParamSpec, TypeVar

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.job.folder import find_point_workers
from hpcapp.applications.surface.job.scan import PointFolder
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.pipeline import load
from hpcapp.backends.selection import Backend
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.progress import Progress, StageClock
from hpcapp.workforce import Workforce

P = ParamSpec("P")
R = TypeVar("R")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    normals = np.random.default_rng(1).normal(size=(1_500, 3))
    write_points(tmp_path / "scan.ply", PointCloud(normals, normals))
    return tmp_path / "scan.ply"


@pytest.mark.parametrize("sees", [True, False])
@pytest.mark.parametrize("sees_input", [True, False])
def test_workers_elsewhere_are_asked_what_they_see(
    scan: Path, tmp_path: Path, sees: bool, sees_input: bool
) -> None:
    """Of a machine on which some of the files are not there."""
    seen = (sees, sees and sees_input)

    class Elsewhere(Workforce):
        def sees(self, *files: Path) -> bool:
            return seen[files[-1] == scan]

    with ThreadPoolExecutor(1) as executor:
        backend = Backend("dask", Elsewhere(executor))
        workers = find_point_workers(scan, tmp_path / "job" / "points", backend, 1_000)
    assert (workers.workers_see, workers.workers_see_input) == seen
    assert list((tmp_path / "job").iterdir()) == []


class RunsTwice(ThreadPoolExecutor):
    """Runs every task again after its result is there, as for a worker that lags."""

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        first = super().submit(fn, *args, **kwargs)
        with contextlib.suppress(RuntimeError):  # it is shut down while the last ones come
            first.add_done_callback(lambda _: super(RunsTwice, self).submit(fn, *args, **kwargs))
        return first


@pytest.mark.slow
@pytest.mark.parametrize("round_", range(5))
def test_a_task_that_runs_again_late_changes_nothing(
    scan: Path, tmp_path: Path, round_: int
) -> None:
    settings = JobSettings(scan, "mesh.ply")
    clouds = []
    for name, kind in (("once", ThreadPoolExecutor), ("twice", RunsTwice)):
        with kind(2) as executor:
            workers = PointWorkers(Workforce(executor, 2, 4), True, 100)
            there = PointFolder(tmp_path / name, workers)
            loaded = load(settings, StageClock(Progress()), there)
            clouds.append(loaded.cloud.take_blocks(loaded.cloud.keys))
    for once, twice in zip(*clouds, strict=True):
        np.testing.assert_array_equal(once, twice)
