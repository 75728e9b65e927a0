import numpy as np
import pytest

from hpcapp.applications.surface.coarse import fit_coarse
from hpcapp.applications.surface.hierarchical import HierarchicalMethod
from hpcapp.backends import SerialExecutor
from hpcapp.batches import Workforce
from hpccomponent.errors import JobError
from hpccomponent.runtime.idle import IdleWork
from hpccomponent.surface import prepared_tile, region
from hpccomponent.surface.arranged_cloud import arrange_cloud
from hpccomponent.surface.points import PointCloud
from hpccomponent.surface.prepared_tile import lay_corners
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
    coarse = fit_coarse(partition.plan, sums, Workforce(SerialExecutor()), 1)
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
    done = []

    def lay_aloud(*given):
        done.append("begin")
        corners = yield from lay_corners(*given)
        done.append("end")
        return corners

    monkeypatch.setattr(prepared_tile, "lay_corners", lay_aloud)
    method = HierarchicalMethod(48)
    partition = method.partition(ball(4000), Workforce(SerialExecutor(), 2))
    plan, tiling = partition.plan.to_values(), partition.tiling
    points = [tiling.tile(index) for index in range(2)]
    sums = [sum_tile(plan, some, name) for some, name in zip(points, "ab", strict=True)]
    assert not done
    coarse = fit_coarse(partition.plan, sums, Workforce(SerialExecutor()), 1)
    around = [coarse.around(tiling.own(index)).to_values() for index in range(2)]
    wanted = mesh_tile(plan, points[1], "b", around[1])
    assert done == ["begin", "end"]
    while idle:  # the first tile's; the second is meshed already
        idle.run_one()
    assert done == ["begin", "end"] * 2
    mesh_tile(plan, points[0], "a", around[0])
    assert done == ["begin", "end"] * 2
    for steps in range(1, 5):  # what is begun ahead is gone on with
        sum_tile(plan, points[1], "c")
        for _ in range(steps):
            idle.run_one()
        assert_same(mesh_tile(plan, points[1], "c", around[1]), wanted)
        assert done == ["begin", "end"] * (2 + steps)
        while idle:
            idle.run_one()
