from __future__ import annotations

import re

import pytest

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.resolution import memory
from hpcapp.applications.surface.resolution.memory import check_memory, count_surface_cells
from hpcapp.geometry.points import PointCloud
from hpccomponent.errors import UsageError


def test_a_volume_grows_with_the_third_power_and_a_surface_with_the_second(
    sphere: PointCloud,
) -> None:
    for method, power in ((Paper(), 3), (Hierarchical(), 2)):
        fine, coarse = (
            method.estimate_memory(grid, len(sphere), count_surface_cells(grid, sphere))
            for grid in (2048, 1024)
        )
        ratio = fine / coarse
        assert method.memory_power == power
        assert ratio == pytest.approx(2.0**power, rel=0.2)


def test_what_does_not_fit_is_refused_with_what_does(
    sphere: PointCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "available_memory", lambda: 8.0 * 2**30)
    cloud = arrange_cloud(sphere)
    check_memory(Hierarchical(), 512, cloud)
    with pytest.raises(UsageError) as caught:
        check_memory(Paper(), 4096, cloud)
    said = re.match(r"choose grid=(\d+) or smaller", caught.value.advice)
    assert said is not None
    fitting = int(said[1])
    assert 256 < fitting < 4096
    check_memory(Paper(), fitting, cloud)


def test_a_system_that_does_not_say_refuses_nothing(
    sphere: PointCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "available_memory", lambda: None)
    check_memory(Paper(), 4096, arrange_cloud(sphere))
