"""Where a cloud is reconstructed, and what runs there."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.job.backend_choice import approach_workers
from hpcapp.applications.surface.job.settings import JobSettings, Settings
from hpcapp.applications.surface.job.site import open_site, preprocess
from hpcapp.applications.surface.pipeline import load, reconstruct_cloud
from hpcapp.applications.surface.tiles.checkpoint import Checkpoint
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.progress import Progress, StageClock

P = ParamSpec("P")
R = TypeVar("R")


class OtherMachine(Executor):
    """Where a folder of the master's is another one under the same name.

    Parameters
    ----------
    folder, other : Path
        The master's, and the one that is there.
    """

    def __init__(self, folder: Path, other: Path) -> None:
        self._folder, self._other = str(folder), str(other)

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Run a task with the names as they are understood there."""
        future: Future[R] = Future()
        future.set_running_or_notify_cancel()
        try:
            there = cast("Callable[..., R]", fn)  # of the same types
            future.set_result(there(*(self._understand(value) for value in args), **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future

    def _understand(self, value: object) -> object:
        if isinstance(value, str):
            return value.replace(self._folder, self._other)
        if isinstance(value, tuple | list):
            return type(value)(self._understand(one) for one in value)
        return value


@pytest.mark.parametrize("sees", [True, False])
def test_tiles_are_kept_by_who_sees_the_folder(tmp_path: Path, sees: bool) -> None:
    normals = random_directions(4_000, 1)
    write_points(tmp_path / "ball.ply", PointCloud(normals, normals))
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    settings = JobSettings(tmp_path / "ball.ply", "-", grid=48, workers=2, temp_dir=str(here))
    clock = StageClock(Progress())
    loaded = load(settings, clock)
    checkpoint, machine = Checkpoint(str(here), "job"), OtherMachine(here, here if sees else there)
    checkpoint.make_folders()
    with approach_workers(settings) as opener:
        site = partial(
            open_site, len(loaded.cloud), opener, clock, checkpoint=checkpoint, executor=machine
        )
        with reconstruct_cloud(settings, loaded, site, clock) as outcome:
            mesh = outcome.result.surface.mesh()
            assert list(there.iterdir()) == []
            kept = checkpoint.store.list("job/")
    assert len(kept) >= 2
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 1.0, atol=0.01)
    assert len(mesh.vertices) - len(mesh.faces) // 2 == 2  # closed, of genus 0


def test_the_papers_steps_run_in_its_order_as_stages(sphere: PointCloud) -> None:
    clock, cloud = StageClock(Progress()), MemoryCloud.as_they_are(sphere)
    found = preprocess(Settings(outliers=True, resample=True), cloud, clock)
    assert list(clock.seconds) == ["remove outliers", "resample"]
    assert 0 < len(found) < len(sphere)
    assert preprocess(Settings(), cloud, clock) is cloud
