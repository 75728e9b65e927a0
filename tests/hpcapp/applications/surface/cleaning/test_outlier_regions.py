"""Outliers that are looked for in regions are those of the whole, whatever the rank of most."""

from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cleaning import outlier_regions
from hpcapp.applications.surface.cleaning.outlier_regions import (
    DroppedCells,
    judge_sparse,
    rank_region,
)
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import BoolArray, FloatArray


def _cloud(seed: int) -> FloatArray:
    """A sphere that is dense on one side, a patch, two small pieces and points far away."""
    random = np.random.default_rng(seed)
    sphere = random_directions(9_000, random)
    sphere = sphere[random.random(len(sphere)) < 10.0 ** (-0.8 * (1 - sphere[:, 2]))]
    patch = random.uniform(-0.3, 0.3, (40, 3)) * (1.0, 1.0, 0.01) - (0.0, 0.0, 1.3)
    pieces = [place + 0.02 * random.normal(size=(8, 3)) for place in ((2, 1, 0), (0, 2, 1))]
    return np.concatenate([sphere, patch, *pieces, random.uniform(-2, 2, (80, 3))])


def _slabs(positions: FloatArray, count: int) -> list[np.ndarray]:
    """Return masks of the points between planes, of which each has about as many."""
    bounds = np.quantile(positions[:, 0], np.linspace(0, 1, count + 1)[1:-1])
    slab = np.searchsorted(bounds, positions[:, 0])
    return [slab == i for i in range(count)]


Region = tuple[FloatArray, BoolArray, FloatArray, float]


def _find_outliers(positions: FloatArray, spacing: float, regions: list[Region]) -> np.ndarray:
    judged = judge_sparse([rank_region(*region) for region in regions])
    low, _ = bound_points(positions)
    cells = DroppedCells(low, spacing, judged.stray_cells, judged.island_cells)
    return ~cells.find_kept(positions)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("factor", [0.06, 0.12, 0.25, 0.5, 1.0, 2.0])
def test_any_rank_may_be_that_of_most_points(seed: int, factor: float) -> None:
    positions = _cloud(seed)
    spacing = factor * estimate_spacing(positions)
    low, _ = bound_points(positions)
    margin = outlier_regions.MARGIN * spacing
    regions = []
    for own in _slabs(positions, 6):
        x = positions[own, 0]
        near = (positions[:, 0] >= x.min() - margin) & (positions[:, 0] <= x.max() + margin)
        regions.append((positions[near], own[near], low, spacing))
    found = _find_outliers(positions, spacing, regions)
    everything = (positions, np.ones(len(positions), np.bool_), low, spacing)
    expected = _find_outliers(positions, spacing, [everything])
    assert found.tolist() == expected.tolist()
    if factor <= 1.0:
        assert expected.any()
    if factor == 0.06:
        judged = judge_sparse([rank_region(*region) for region in regions])
        assert judged.base > outlier_regions.LOCAL_RANK
