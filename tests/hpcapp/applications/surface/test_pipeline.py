from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.paper.method import PaperMethod
from hpcapp.applications.surface.pipeline import make_surface
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import PointCloud
from hpcapp.progress import Progress, StageClock
from hpcapp.workforce import Workforce
from hpccomponent.runtime.background import Deferred

SERIAL = Workforce(SerialExecutor())


def test_the_stages_run_in_the_papers_order(sphere: PointCloud) -> None:
    clock = StageClock(Progress())
    result = make_surface(MemoryCloud.as_they_are(sphere), PaperMethod(grid=24), SERIAL, clock)
    assert list(clock.seconds) == ["partition", "fit", "extract", "close"]
    assert result.points == len(sphere)
    assert result.facts["patches"] >= 1
    topology = result.surface.check()
    assert topology.watertight
    mesh = result.surface.mesh()
    assert topology.faces == len(mesh.faces)
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.median(np.abs(radii - 1.0)) < 0.05


def test_what_is_left_for_meanwhile_is_left_once_the_cloud_is_cut(sphere: PointCloud) -> None:
    clock, left = StageClock(Progress()), []

    class Recording(Workforce):
        def defer(self, find: Callable[[], Any]) -> Deferred[Any]:
            left.append((find, list(clock.seconds)))
            return super().defer(find)

    def meanwhile() -> None:
        raise AssertionError  # in one process nobody waits

    workforce = Recording(SerialExecutor(), in_process=True)
    make_surface(MemoryCloud.as_they_are(sphere), PaperMethod(grid=24), workforce, clock, meanwhile)
    assert left == [(meanwhile, ["partition"])]
