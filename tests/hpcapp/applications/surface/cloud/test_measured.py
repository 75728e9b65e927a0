from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.cloud.measured import (
    Points,
    draw_sample,
    first_share,
    measure_points,
)
from hpcapp.geometry.points import PointCloud
from hpccomponent.errors import InputError


def test_points_without_normals_are_refused() -> None:
    with pytest.raises(InputError, match="no normals"):
        measure_points(PointCloud(np.eye(3)))


@pytest.mark.parametrize("count", [20_000, 200_000])
def test_large_clouds_are_judged_by_a_sample(count: int) -> None:
    drawn: list[int] = []

    def draw(one_in: int) -> Points:
        drawn.append(one_in)
        return np.zeros((count // one_in, 3)), np.zeros((count // one_in, 3))

    assert len(draw_sample(draw, count)[0]) <= 20_000
    assert drawn == [max(count // 15_000, 1)]


def test_a_sample_of_few_boxes_is_drawn_anew() -> None:
    """Lumps in eight boxes: a share of them, as of the boxes of a surface, may be none."""
    lumps = np.random.default_rng(3).normal(size=(200_000, 3)) * 1e-3
    lumps += np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])[
        np.arange(len(lumps)) % 8
    ]

    def draw(one_in: int) -> Points:
        rows = kernels.sample_boxes(lumps, lumps.min(axis=0), 24 * 0.01, one_in)
        return lumps[rows], lumps[rows]

    assert len(draw(first_share(len(lumps)))[0]) <= 15_000 // 4
    assert len(draw_sample(draw, len(lumps))[0]) > 15_000 // 4
