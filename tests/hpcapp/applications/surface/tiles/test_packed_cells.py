"""Packed points in the order of their cells, against the same points unpacked."""

from __future__ import annotations

from dataclasses import astuple
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.arrangement import (
    PackedPoints,
    pack_points,
    unpacking_arguments,
)
from hpcapp.applications.surface.field.cell_points import CloudRows
from hpcapp.applications.surface.tiles import packed_cells
from hpcapp.applications.surface.tiles.packed_cells import sort_tile
from hpcapp.geometry.lattice import cells_of, find_keys, pack_places, unique_keys
from hpcapp.geometry.points import PointCloud
from hpcapp.kernels import portable
from hpcapp.kernels.build import load_native
from hpcapp.kernels.portable.lattice.points import sort_points
from hpcapp.kernels.types.grid import Grid

BUILDS = [build for build in (portable, load_native()) if build is not None]


@pytest.fixture(params=BUILDS, ids=[module.__name__.rsplit(".", 1)[1] for module in BUILDS])
def build(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Run in each build that loads."""
    kernels: ModuleType = request.param
    monkeypatch.setattr(packed_cells, "kernels", kernels)
    return kernels


def sorted_tile(points: int, size: float, depth: int, seed: int) -> tuple[Any, ...]:
    """Return a cloud's points in two groups of coarse cells: unpacked, and packed and sorted."""
    random = np.random.default_rng(seed)
    arranged = arrange_cloud(PointCloud(*random.normal(size=(2, points, 3))))
    positions, normals = arranged.points.positions, arranged.points.normals
    assert normals is not None
    origin = random.normal(size=3)
    coarse = sort_points(positions, origin, size * 2.0**depth)[0]
    wanted = coarse[random.random(len(coarse)) < 0.7]
    numbers = random.integers(0, 2, len(wanted)).astype(np.uint8)
    places = np.floor(cells_of(positions, origin, size * 2.0**depth)).astype(np.int64)
    of_coarse = find_keys(wanted, pack_places(places))
    rows = np.flatnonzero(of_coarse < len(wanted))
    taken, groups = (positions[rows], normals[rows]), numbers[of_coarse[rows]]
    packed = pack_points(arranged.arrangement, positions, normals)
    lattice = origin, size, depth, wanted, numbers
    return (*taken, groups), sort_tile(arranged.arrangement, packed, *lattice), (origin, size)


@given(st.integers(2, 400), st.floats(0.01, 3.0), st.integers(0, 3), st.integers(0, 99))
@settings(deadline=None, max_examples=60)
def test_a_tile_holds_the_points_of_its_cells_bit_for_bit(
    points: int, size: float, depth: int, seed: int
) -> None:
    (positions, normals, groups), found, lattice = sorted_tile(points, size, depth, seed)
    cells, offsets, rows, group_of = found
    assert len(rows) == len(positions)
    if not len(positions):
        assert not len(cells)
        assert offsets.tolist() == [0]
        return
    expected, ends, order = sort_points(positions, *lattice)
    np.testing.assert_array_equal(cells, expected)
    np.testing.assert_array_equal(offsets, ends)
    np.testing.assert_array_equal(group_of, groups[order[ends[:-1]]])
    cloud = CloudRows(PointCloud(positions, normals), order)
    some = slice(int(offsets[len(cells) // 2]), len(rows))
    for one, other in zip(rows.place(some, *lattice), cloud.place(some, *lattice), strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("points", [2, 500])
def test_bricks_that_hold_points_of_some_cells(build: ModuleType, points: int) -> None:
    (positions, normals, groups), found, lattice = sorted_tile(points, 0.3, 1, 7)
    cells, offsets, rows, group_of = found
    grid = Grid(np.full(3, -8.0), 0.125, (16, 16, 16))
    expected, ends, order = sort_points(positions, *lattice)
    cloud = CloudRows(PointCloud(positions, normals), order)
    for group in range(3):
        seeds = rows.seed_bricks(grid, offsets, group_of == group)
        own = positions[groups == group]
        bricks = np.floor((own - grid.origin) / (8 * grid.step)).astype(np.int64)
        np.testing.assert_array_equal(seeds, unique_keys(pack_places(bricks)))
        assert seeds.tobytes() == cloud.seed_bricks(grid, ends, group_of == group).tobytes()
    np.testing.assert_array_equal(cells, expected)


def test_no_cell_is_wanted(build: ModuleType) -> None:
    positions = np.random.default_rng(1).random((50, 3))
    arranged = arrange_cloud(PointCloud(positions, positions))
    packed = pack_points(arranged.arrangement, positions, positions)
    none = np.empty(0, np.int64), np.empty(0, np.uint8)
    cells, offsets, rows, groups = sort_tile(
        arranged.arrangement, packed, np.zeros(3), 0.1, 2, *none
    )
    assert [len(cells), len(rows), len(groups), *offsets] == [0, 0, 0, 0]
    assert not len(rows.seed_bricks(Grid(np.zeros(3), 0.1, (2, 2, 2)), offsets, groups == 0))


@pytest.mark.parametrize("size", [0.05, 0.7, 9.0])
def test_points_are_counted_as_if_they_were_sorted(build: ModuleType, size: float) -> None:
    random = np.random.default_rng(4)
    arranged = arrange_cloud(PointCloud(*random.uniform(size=(2, 30_000, 3)) ** 9))
    blocks, cloud = arranged.arrangement, arranged.points
    assert cloud.normals is not None
    packed = pack_points(blocks, cloud.positions, cloud.normals)
    assert packed.counts.max() > 64  # what the kernel takes at once
    origin = random.normal(size=3)
    cells, offsets, _ = sort_points(cloud.positions, origin, size)
    keys, counts = build.count_packed(*unpacking_arguments(blocks, packed), origin, size)
    np.testing.assert_array_equal(keys, cells)
    np.testing.assert_array_equal(counts, np.diff(offsets))
    nothing = PackedPoints(*(column[:0] for column in astuple(packed)))
    counted = build.count_packed(*unpacking_arguments(blocks, nothing), origin, size)
    assert [len(column) for column in counted] == [0, 0]
