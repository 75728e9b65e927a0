"""Strewn points are found; whatever a scan may hold of itself is kept."""

from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cleaning.outlier_regions import (
    DroppedCells,
    judge_sparse,
    rank_region,
)
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.geometry.lattice import pack_places, unique_keys, unpack_keys
from hpcapp.geometry.points import FloatArray
from hpcapp.kernels import portable


def sphere(count: int) -> FloatArray:
    return random_directions(count, 0)


def torus(count: int, seed: int = 0) -> FloatArray:
    u, v = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, (2, count))
    ring = 1.0 + 0.3 * np.cos(v)
    return np.stack([ring * np.cos(u), ring * np.sin(u), 0.3 * np.sin(v)], axis=1)


def thinned(points: FloatArray, ratio: float, seed: int = 0) -> FloatArray:
    """Thin a cloud along x, from its full density down by `ratio`."""
    along = (points[:, 0] - points[:, 0].min()) / np.ptp(points[:, 0])
    values: FloatArray = points[np.random.default_rng(seed).random(len(points)) < ratio**-along]
    return values


def found(points: FloatArray) -> np.ndarray:
    """Judge a cloud as one region."""
    low, spacing, own = points.min(axis=0), estimate_spacing(points), np.ones(len(points), np.bool_)
    judged = judge_sparse([rank_region(points, own, low, spacing)])
    cells = DroppedCells(low, spacing, judged.stray_cells, judged.island_cells)
    return ~cells.find_kept(points)


CLEAN = {
    "sphere": sphere(20_000),
    "sparse": sphere(1_000),
    "torus": torus(30_000),
    "noisy": sphere(20_000) * (1.0 + 0.02 * np.random.default_rng(1).normal(size=(20_000, 1))),
    "uneven": thinned(torus(100_000), 30.0),
    "sparse and uneven": thinned(sphere(8_000), 30.0),
    "open": sphere(20_000)[sphere(20_000)[:, 2] < 0.2],
    "bowl with a hole": sphere(20_000)[np.abs(sphere(20_000)[:, 2]) < 0.9],
    "two objects, one small": np.concatenate([sphere(20_000), 0.1 * sphere(200) + (2.0, 0.0, 0.0)]),
    "plate and rod": np.concatenate(
        [
            np.random.default_rng(2).uniform((-1, -1, 0), (1, 1, 0.01), (20_000, 3)),
            np.random.default_rng(3).uniform((1, 0, 0), (3, 0.02, 0.01), (1_000, 3)),
        ]
    ),
}


@pytest.mark.parametrize("name", CLEAN)
def test_nothing_is_dropped_from_a_clean_scan(name: str) -> None:
    assert not found(CLEAN[name]).any()


@pytest.mark.parametrize("share", [0.01, 0.03])
@pytest.mark.parametrize("uneven", [False, True])
def test_strewn_points_are_found(share: float, uneven: bool) -> None:
    random = np.random.default_rng(4)
    surface = thinned(sphere(150_000), 30.0) if uneven else sphere(40_000)
    strewn = random.uniform(-2.0, 2.0, (int(share * len(surface)), 3))
    points = np.concatenate([surface, strewn])
    off = np.abs(np.linalg.norm(strewn, axis=1) - 1.0)
    dropped = found(points)
    assert not dropped[: len(surface)].any()
    apart = off > (0.2 if uneven else 0.12)  # 10 spacings where points are few
    assert dropped[len(surface) :][apart].mean() > 0.97


def test_points_that_hang_beside_the_surface_are_found() -> None:
    random = np.random.default_rng(5)
    surface = sphere(50_000)
    spacing = estimate_spacing(surface)
    heights = random.uniform(8.0, 30.0, (300, 1)) * random.choice([-1.0, 1.0], (300, 1))
    hanging = surface[:300] * (1.0 + spacing * heights)
    dropped = found(np.concatenate([surface, hanging]))
    assert not dropped[:50_000].any()
    assert dropped[50_000:].mean() > 0.98


def test_a_small_clump_is_dropped_only_far_from_all_else() -> None:
    surface, clump = sphere(20_000), 0.02 * sphere(30)
    far = found(np.concatenate([surface, clump + np.array([2.5, 0.0, 0.0])]))
    assert far[20_000:].all()
    assert not far[:20_000].any()
    near = found(np.concatenate([surface, clump + np.array([1.1, 0.0, 0.0])]))
    assert not near.any()


def test_the_result_depends_on_neither_order_nor_unit() -> None:
    points = np.concatenate([sphere(5_000), np.random.default_rng(6).uniform(-3, 3, (100, 3))])
    dropped = found(points)
    assert dropped.any()
    order = np.random.default_rng(7).permutation(len(points))
    np.testing.assert_array_equal(found(points[order]), dropped[order])
    np.testing.assert_array_equal(found(1024.0 * points), dropped)


@pytest.mark.parametrize("count", [10, 12])
def test_a_handful_of_points_is_left_alone(count: int) -> None:
    assert not found(sphere(count)).any()


def test_cells_are_counted_and_summed() -> None:
    random = np.random.default_rng(8)
    points = random.uniform(-2.0, 2.0, (500, 3))
    low = points.min(axis=0)
    keys, counts, cell_of = portable.count_cells(points, low, 0.5)
    places = np.floor((points - low) / 0.5).astype(np.int64)
    np.testing.assert_array_equal(unpack_keys(keys[cell_of]), places)
    np.testing.assert_array_equal(keys, unique_keys(pack_places(places)))
    np.testing.assert_array_equal(counts, np.bincount(cell_of))
    wanted = np.arange(0, len(keys), 3)
    sums = portable.sum_neighbours(keys, counts[:, None], wanted)[:, 0]
    apart = np.abs(places[None] - unpack_keys(keys[wanted])[:, None]).max(axis=2)
    np.testing.assert_array_equal(sums, (apart <= 1).sum(axis=1))
