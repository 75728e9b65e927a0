from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.applications.surface.cloud.cutting import cut_tiles
from hpcapp.applications.surface.hierarchical.tiles import weigh_cells
from hpcapp.applications.surface.tiles.halo import mark_near
from hpcapp.applications.surface.tiles.plan import TilePlan
from hpcapp.geometry.lattice import pack_places, spread_keys, unique_keys


@given(st.integers(0, 2**32), st.integers(1, 200), st.integers(1, 20))
def test_tiles_share_the_work(seed: int, cells: int, count: int) -> None:
    random = np.random.default_rng(seed)
    keys = unique_keys(pack_places(random.integers(-9, 9, (cells, 3))))
    work = random.integers(1, 50, len(keys))
    tiles = cut_tiles(keys, work, count)
    assert np.array_equal(np.unique(tiles), np.arange(min(count, len(keys))))
    if count < len(keys) // 4:
        shares = np.bincount(tiles, work)
        rounds = np.ceil(np.log2(count))  # each halving is off by a cell at most
        assert np.abs(shares - work.sum() / count).max() <= work.max() * (1 + rounds)


def test_tiles_are_compact() -> None:
    """Of a flat square the halos are those of smaller squares, not of rows."""
    places = np.argwhere(np.ones((32, 32, 1), bool))
    keys = unique_keys(pack_places(places))
    tiles = cut_tiles(keys, np.ones(len(keys), np.int64), 16)
    around = spread_keys(keys, -1, 1)
    for tile in range(16):
        own = keys[tiles == tile]
        flat = np.array([1, 1, 0])
        assert len(own) == 64
        assert np.count_nonzero(mark_near(around, own, flat, flat)) == 100


def test_where_points_are_few_the_surface_is_work_still() -> None:
    """A flat square, one half of it scanned a hundred times as densely: its surface is the same."""
    places = np.argwhere(np.ones((64, 32, 1), bool))
    keys = pack_places(places)
    counts = np.where(places[:, 0] < 32, 4, 400)
    low = np.zeros(3)
    plan = TilePlan(low, 1.0, 5, 3, 0.0, low, 0.5, (40, 20, 2), low, 8.0, 3, 128, np.zeros(3))
    work = weigh_cells(plan, counts)
    assert np.all(work > counts)
    assert np.ptp(work - counts) < 1e-9
    finer = replace(plan, step=0.25)
    assert np.all(weigh_cells(finer, counts) > work)  # more nodes
    sizes = np.bincount(cut_tiles(keys, work, 8))
    by_points = np.bincount(cut_tiles(keys, counts, 8))
    assert by_points.max() > 8 * by_points.min()
    assert sizes.max() < 4 * sizes.min()
