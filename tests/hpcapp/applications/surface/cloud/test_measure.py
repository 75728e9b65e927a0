from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.arranged import MemoryCloud, arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import (
    SAMPLED_BOX,
    draw_boxes,
    first_share,
    measure_cloud,
    measure_points,
    replace_points,
)
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.points import PointCloud


def _cloud(positions: np.ndarray) -> PointCloud:
    return PointCloud(positions, np.tile([0.0, 0.0, 1.0], (len(positions), 1)))


@pytest.mark.parametrize("count", [10_000, 20_000, 200_000])
def test_large_clouds_are_judged_by_a_sample(count: int) -> None:
    plane = np.random.default_rng(1).random((count, 3)) * (1.0, 1.0, 0.0)
    sample = measure_points(_cloud(plane)).measured.sample
    assert min(count, 10_000) <= len(sample) <= 25_000


def test_a_sample_of_few_boxes_is_drawn_anew() -> None:
    """Lumps in eight boxes: a share of them, as of the boxes of a surface, may be none."""
    lumps = np.random.default_rng(3).normal(size=(200_000, 3)) * 1e-3
    lumps += np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])[
        np.arange(len(lumps)) % 8
    ]
    cloud_pass = MemoryPass(arrange_cloud(_cloud(lumps)))
    drawn = draw_boxes(cloud_pass, SAMPLED_BOX * 0.01, first_share(len(lumps)))
    assert len(drawn[0]) <= 15_000 // 4
    measured = measure_cloud(cloud_pass, LocalScale.uniform(0.01)).cloud.measured
    assert len(measured.sample) > 15_000 // 4


def test_other_points_are_held_as_those_before() -> None:
    scan = _cloud(np.random.default_rng(1).random((500, 3)) * (1.0, 1.0, 0.0))
    raw, arranged = MemoryCloud.as_they_are(scan), measure_points(scan)
    kept = raw.select(np.arange(len(scan)) % 2 == 0)
    for other in (raw, kept):
        assert replace_points(other, scan).points is scan
    again = replace_points(arranged, scan)
    assert again.points.positions.tobytes() == arranged.points.positions.tobytes()
    assert again.measured.spacing == arranged.measured.spacing
