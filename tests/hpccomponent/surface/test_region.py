import gc
import weakref

import numpy as np
import pytest

from hpcapp.applications.surface.coarse import fit_coarse
from hpcapp.applications.surface.hierarchical import HierarchicalMethod
from hpcapp.backends import SerialExecutor
from hpcapp.batches import Workforce
from hpccomponent.errors import JobError
from hpccomponent.runtime.idle import IdleWork
from hpccomponent.store import FolderStore
from hpccomponent.surface import prepared_tile, region
from hpccomponent.surface.arranged_cloud import arrange_cloud
from hpccomponent.surface.points import PointCloud
from hpccomponent.surface.prepared_tile import PreparedTile, lay_corners
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


def test_moments_can_be_kept_in_a_folder(tmp_path):
    method = HierarchicalMethod(48)
    partition = method.partition(ball(4000), Workforce(SerialExecutor(), 2))
    plan, points = partition.plan.to_values(), partition.tiling.tile(0)
    cells, moments, *more = sum_tile(plan, points)
    kept_cells, nothing, *kept_more = sum_tile(plan, points, None, (str(tmp_path), "job/sums"))
    assert nothing is None
    assert_same((kept_cells, *kept_more), (cells, *more))
    assert_same(FolderStore(tmp_path).get("job/sums"), moments)


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


def test_what_fails_in_idle_time_is_tried_again_by_the_task(monkeypatch):
    idle = IdleWork()
    idle.serve()
    monkeypatch.setattr(region, "idle_work", idle)
    method = HierarchicalMethod(48)
    partition = method.partition(ball(4000), Workforce(SerialExecutor(), 2))
    plan, tiling = partition.plan.to_values(), partition.tiling
    sums = [sum_tile(plan, tiling.tile(index), None) for index in range(2)]
    coarse = fit_coarse(partition.plan, sums, Workforce(SerialExecutor()), 1)
    given = tiling.tile(1), coarse.around(tiling.own(1)).to_values()
    wanted = mesh_tile(plan, given[0], None, given[1])

    def lack(*_):
        raise MemoryError

    for steps, name in ((0, "plan_tile"), (1, "near_bricks")):
        sum_tile(plan, given[0], "d")
        for _ in range(steps):
            idle.run_one()
        with monkeypatch.context() as patch:
            patch.setattr(prepared_tile, name, lack)
            idle.run_one()
        assert not idle
        assert_same(mesh_tile(plan, given[0], "d", given[1]), wanted)


def test_tiles_leave_memory_with_their_last_use(monkeypatch):
    """At once: a collector of cycles counts objects, and these are few but large."""
    found = []

    class Watched(PreparedTile):
        def __init__(self, *given):
            super().__init__(*given)
            found.append(weakref.ref(self))

    monkeypatch.setattr(region, "PreparedTile", Watched)
    method = HierarchicalMethod(48)
    partition = method.partition(ball(4000), Workforce(SerialExecutor(), 2))
    plan, points = partition.plan.to_values(), partition.tiling.tile(0)
    gc.disable()
    try:
        sum_tile(plan, points)
        assert [tile() for tile in found] == [None]
        for number in range(KEPT_TILES + 2):
            sum_tile(plan, points, f"e{number}")
            found[-1]().lay_some()
        assert [tile() is None for tile in found[1:]] == [True] * 2 + [False] * KEPT_TILES
    finally:
        gc.enable()
        region._waiting.clear()
