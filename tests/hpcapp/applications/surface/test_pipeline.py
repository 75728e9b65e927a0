from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.paper.method import PaperMethod
from hpcapp.applications.surface.pipeline import reconstruct
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import PointCloud
from hpcapp.progress import Progress, StageClock
from hpcapp.workforce import Workforce
from hpccomponent.errors import InputError
from hpccomponent.runtime.background import Deferred

SERIAL = Workforce(SerialExecutor())


def test_the_stages_run_in_the_papers_order(sphere: PointCloud) -> None:
    clock = StageClock(Progress())
    halve = ("halve", lambda cloud: cloud.take(np.arange(0, len(cloud), 2)))
    result = reconstruct(
        MemoryCloud.as_they_are(sphere), PaperMethod(grid=24), SERIAL, clock, (halve,)
    )
    assert list(clock.seconds) == ["halve", "partition", "fit", "extract"]
    assert result.points == len(sphere) // 2
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
    reconstruct(
        MemoryCloud.as_they_are(sphere), PaperMethod(grid=24), workforce, clock, (), meanwhile
    )
    assert left == [(meanwhile, ["partition"])]


def test_what_a_step_refuses_ends_the_job(sphere: PointCloud) -> None:
    def refuse(cloud: PointCloud) -> PointCloud:
        raise InputError("nothing to see", "scan again")

    clock = StageClock(Progress())
    with pytest.raises(InputError, match="scan again"):
        reconstruct(
            MemoryCloud.as_they_are(sphere), PaperMethod(), SERIAL, clock, (("refuse", refuse),)
        )
    assert clock.seconds == {}
