from __future__ import annotations

import gc
import weakref
from collections.abc import Generator
from dataclasses import astuple, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.cloud.arrangement import PackedPoints
from hpcapp.applications.surface.cloud.measure import measure_points
from hpcapp.applications.surface.extraction.parts import MeshPart, join_parts
from hpcapp.applications.surface.field.cell_points import SortedPoints
from hpcapp.applications.surface.hierarchical.coarse import Coarse, fit_coarse
from hpcapp.applications.surface.hierarchical.method import HierarchicalMethod
from hpcapp.applications.surface.hierarchical.tiles import Tiling
from hpcapp.applications.surface.tiles import prepared as prepared_tile
from hpcapp.applications.surface.tiles import slabs as slab_growth
from hpcapp.applications.surface.tiles import tasks as region
from hpcapp.applications.surface.tiles.plan import TilePlan
from hpcapp.applications.surface.tiles.points import PointsThere, TilePoints, take_points
from hpcapp.applications.surface.tiles.prepared import PreparedTile, TileCache, lay_corners
from hpcapp.applications.surface.tiles.tasks import KEPT_TILES, mesh_tile, solve_far, sum_tile
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import PointCloud
from hpcapp.workforce import Workforce
from hpccomponent.errors import JobError
from hpccomponent.runtime.background import Background
from hpccomponent.store.base import FolderStore


def ball(count: int) -> MemoryCloud:
    normals = random_directions(count, 5)
    return measure_points(PointCloud(normals, normals))


def assert_same(found: Any, wanted: Any) -> None:
    if is_dataclass(wanted) and not isinstance(wanted, type):
        assert type(found) is type(wanted)
        found, wanted = astuple(found), astuple(wanted)
    if isinstance(wanted, tuple):
        for one, other in zip(found, wanted, strict=True):
            assert_same(one, other)
    else:
        np.testing.assert_array_equal(found, wanted)


def own_of(points: Any) -> tuple[PackedPoints]:
    own: tuple[PackedPoints] = points[:1]
    return own


def cut_in_two(method: HierarchicalMethod) -> tuple[TilePlan, Tiling]:
    """Plan two tiles of a ball."""
    partition = method.partition(ball(4000), Workforce(SerialExecutor(), 2))
    assert partition.tiling is not None
    return partition.plan, partition.tiling


def fit_sums(plan: TilePlan, sums: Any) -> Coarse:
    lattices, samples, _ = map(list, zip(*sums, strict=True))
    return fit_coarse(plan, lattices, samples, Workforce(SerialExecutor()), 1)


def test_a_tile_is_prepared_once_where_its_ticket_comes_back() -> None:
    """The second task gets along without the points; with another ticket it must read them."""
    plan, tiling = cut_in_two(HierarchicalMethod(48))
    points = [tiling.tile(index) for index in range(2)]
    assert None not in tiling.tickets
    sums = [sum_tile(plan, some, ticket) for some, ticket in zip(points, "ab", strict=True)]
    for index in range(2):
        assert_same(sum_tile(plan, own_of(points[index])), sums[index])  # without its halo
    coarse = fit_sums(plan, sums)
    nowhere = PointsThere("/nowhere", tuple(tiling.groups(1)))
    around = coarse.around(tiling.own(1))
    wanted = mesh_tile(plan, points[1], None, around)
    sum_tile(plan, points[1], "b")
    assert_same(mesh_tile(plan, nowhere, "b", around), wanted)
    for number in range(KEPT_TILES):
        sum_tile(plan, own_of(points[0]), f"c{number}")
    for ticket in ("a", "b", None):  # the first has made room for others, the second is used
        with pytest.raises(JobError, match="nowhere"):
            mesh_tile(plan, nowhere, ticket, around)
    for number in range(KEPT_TILES):  # nothing is left in memory
        mesh_tile(plan, points[0], f"c{number}", around)


def test_sums_can_be_kept_in_a_folder(tmp_path: Path) -> None:
    """What a tile has sampled lies beside its lattice, and is read by who solves."""
    (tmp_path / "job").mkdir()
    plan, tiling = cut_in_two(HierarchicalMethod(48))
    tiles = [tiling.tile(index) for index in range(len(tiling))]
    sums = [sum_tile(plan, points) for points in tiles]
    names = [f"job/sums-{index}" for index in range(len(tiles))]
    kept = [
        sum_tile(plan, points, None, (str(tmp_path), name))
        for points, name in zip(tiles, names, strict=True)
    ]
    store = FolderStore(tmp_path)
    for name, (lattice, samples, patches), found in zip(names, sums, kept, strict=True):
        nothing, place, same = found
        assert (nothing, same) == (None, patches)
        assert isinstance(place, tuple)
        assert_same(store.get(name), lattice)
        assert_same(store.get(place[1]), samples)
    far = [solve_far(plan, [some for _, some, _ in found]) for found in (sums, kept, sums[::-1])]
    assert_same(far[1], far[0])
    assert_same(far[2], far[0])


def test_corners_are_laid_in_idle_time_and_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    idle = Background()
    idle.enable()
    monkeypatch.setattr(region, "worker_background", idle)
    done: list[str] = []

    def lay_aloud(*given: Any) -> Generator[Any, Any, Any]:
        done.append("begin")
        corners = yield from lay_corners(*given)
        done.append("end")
        return corners

    monkeypatch.setattr(prepared_tile, "lay_corners", lay_aloud)
    plan, tiling = cut_in_two(HierarchicalMethod(48))
    points = [tiling.tile(index) for index in range(2)]
    sums = [sum_tile(plan, some, name) for some, name in zip(points, "ab", strict=True)]
    assert not done
    coarse = fit_sums(plan, sums)
    around = [coarse.around(tiling.own(index)) for index in range(2)]
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


def test_what_fails_in_idle_time_is_tried_again_by_the_task(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    idle = Background()
    idle.enable()
    monkeypatch.setattr(region, "worker_background", idle)
    plan, tiling = cut_in_two(HierarchicalMethod(48))
    sums = [sum_tile(plan, tiling.tile(index), None) for index in range(2)]
    coarse = fit_sums(plan, sums)
    given = tiling.tile(1), coarse.around(tiling.own(1))
    wanted = mesh_tile(plan, given[0], None, given[1])

    def lack(*_: object) -> None:
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


def test_what_a_tile_is_made_of_leaves_memory_before_its_slabs_are_joined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan, tiling = cut_in_two(HierarchicalMethod(48))
    sums = [sum_tile(plan, tiling.tile(index), None) for index in range(2)]
    coarse = fit_sums(plan, sums).around(tiling.own(1))
    made: list[weakref.ref[Any]] = []
    held: list[bool] = []

    def sort(*given: Any) -> TilePoints:
        taken = take_points(*given)
        assert isinstance(taken.finest.points, SortedPoints)
        made.append(weakref.ref(taken.finest.points.offsets))
        return taken

    def join(parts: list[MeshPart]) -> MeshPart:
        held.append(made[-1]() is not None)
        return join_parts(parts)

    monkeypatch.setattr(prepared_tile, "take_points", sort)
    monkeypatch.setattr(slab_growth, "join_parts", join)
    sum_tile(plan, tiling.tile(1), "f")
    for ticket in ("f", None):
        mesh_tile(plan, tiling.tile(1), ticket, coarse)
    assert held == [False, False]


def test_what_the_last_tile_has_left_goes_before_that_is_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """While another waits to be meshed, it takes the memory that this one has left."""
    plan, tiling = cut_in_two(HierarchicalMethod(48))
    points = [tiling.tile(index) for index in range(2)]
    events: list[str] = []
    monkeypatch.setattr(region, "TILES", TileCache(region.KEPT_TILES))
    monkeypatch.setattr(region, "leave_for_files", lambda: events.append("left"))
    monkeypatch.setattr(FolderStore, "put", lambda store, name, value: events.append(name))
    sums = [sum_tile(plan, some, ticket) for some, ticket in zip(points, "gh", strict=True)]
    coarse = fit_sums(plan, sums)
    for index, ticket in ((0, "g"), (1, "h"), (1, None)):  # without tickets more may follow
        around = coarse.around(tiling.own(index))
        mesh_tile(plan, points[index], ticket, around, (str(tmp_path), f"tile-{index}"))
    assert events == ["tile-0", "left", "tile-1", "tile-1"]


def test_tiles_leave_memory_with_their_last_use(monkeypatch: pytest.MonkeyPatch) -> None:
    """At once: a collector of cycles counts objects, and these are few but large."""
    found: list[weakref.ref[PreparedTile]] = []

    class Watched(PreparedTile):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            found.append(weakref.ref(self))

    monkeypatch.setattr(region, "PreparedTile", Watched)
    plan, tiling = cut_in_two(HierarchicalMethod(48))
    points = tiling.tile(0)
    gc.disable()
    try:
        sum_tile(plan, points)
        assert [tile() for tile in found] == [None]
        for number in range(KEPT_TILES + 2):
            sum_tile(plan, points, f"e{number}")
            last = found[-1]()
            assert last is not None
            last.lay_some()
            del last
        assert [tile() is None for tile in found[1:]] == [True] * 2 + [False] * KEPT_TILES
    finally:
        gc.enable()
        monkeypatch.setattr(region, "TILES", TileCache(region.KEPT_TILES))
