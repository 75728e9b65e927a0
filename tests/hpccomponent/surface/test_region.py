import numpy as np
import pytest

from hpcapp.applications.surface.coarse import fit_coarse
from hpcapp.applications.surface.hierarchical import HierarchicalMethod
from hpcapp.backends import SerialExecutor
from hpcapp.batches import Workforce
from hpccomponent.errors import JobError
from hpccomponent.runtime.idle import IdleWork
from hpccomponent.surface import region
from hpccomponent.surface.arranged_cloud import arrange_cloud
from hpccomponent.surface.points import PointCloud
from hpccomponent.surface.region import KEPT_TILES, mesh_tile, sum_tile


def ball(count):
    points = np.random.default_rng(5).normal(size=(count, 3))
    normals = points / np.linalg.norm(points, axis=1)[:, None]
    return arrange_cloud(PointCloud(normals, normals)).cloud


def assert_same(found, wanted):
    if isinstance(wanted, tuple):
        for one, other in zip(found, wanted, strict=True):
            assert_same(one, other)
    else:
        np.testing.assert_array_equal(found, wanted)


def test_a_tile_is_prepared_once_where_its_ticket_comes_back():
    """The second task gets along without the points; with another ticket it must read them."""
    method = HierarchicalMethod(48)
    partition = method.partition(ball(4000), Workforce(SerialExecutor(), 2))
    plan, tiling = partition.plan.to_values(), partition.tiling
    points = [tiling.tile(index) for index in range(2)]
    assert None not in tiling.tickets
    sums = [sum_tile(plan, some, ticket) for some, ticket in zip(points, "ab", strict=True)]
    for index in range(2):
        assert_same(sum_tile(plan, points[index][:2]), sums[index])  # without its halo
    coarse = fit_coarse(partition.plan, sums, 1)
    nowhere = ("there", "/nowhere", *tiling.groups(1))
    around = coarse.around(tiling.own(1)).to_values()
    wanted = mesh_tile(plan, points[1], None, around)
    sum_tile(plan, points[1], "b")
    assert_same(mesh_tile(plan, nowhere, "b", around), wanted)
    for number in range(KEPT_TILES):
        sum_tile(plan, points[0][:2], f"c{number}")
    for ticket in ("a", "b", None):  # the first has made room for others, the second is used
        with pytest.raises(JobError, match="nowhere"):
            mesh_tile(plan, nowhere, ticket, around)
    for number in range(KEPT_TILES):  # nothing is left in memory
        mesh_tile(plan, points[0], f"c{number}", around)


def test_corners_are_laid_in_idle_time_and_change_nothing(monkeypatch):
    idle = IdleWork()
    idle.serve()
    monkeypatch.setattr(region, "idle_work", idle)
    laid, lay_near = [], region._lay_near
    monkeypatch.setattr(
        region, "_lay_near", lambda *given: laid.append(lay_near(*given)) or laid[-1]
    )
    method = HierarchicalMethod(48)
    partition = method.partition(ball(4000), Workforce(SerialExecutor(), 2))
    plan, tiling = partition.plan.to_values(), partition.tiling
    points = [tiling.tile(index) for index in range(2)]
    sums = [sum_tile(plan, some, name) for some, name in zip(points, "ab", strict=True)]
    coarse = fit_coarse(partition.plan, sums, 1)
    around = coarse.around(tiling.own(1)).to_values()
    wanted = mesh_tile(plan, points[1], "b", around)
    assert len(laid) == 1
    idle.run_one()
    assert len(laid) == 2  # of the first tile
    idle.run_one()
    assert len(laid) == 2  # the second is meshed already
    mesh_tile(plan, points[0], "a", coarse.around(tiling.own(0)).to_values())
    assert len(laid) == 2
    sum_tile(plan, points[1], "c")
    idle.run_one()
    assert not idle
    assert_same(mesh_tile(plan, points[1], "c", around), wanted)
    assert len(laid) == 3
