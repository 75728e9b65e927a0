"""Figure 2: what its panels show, against spheres."""

from __future__ import annotations

import numpy as np
import pytest
from spheres import make_sphere

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.paper.method import PaperMethod
from hpcapp.backends.selection import open_executor
from hpcapp.geometry.points import PointCloud
from hpcapp.lab.reproduce.construction import build_discs, project_points


def test_points_come_to_lie_on_their_quadrics() -> None:
    method = PaperMethod(grid=16)
    with open_executor("serial") as opened:
        partition = method.partition(
            MemoryCloud.as_they_are(make_sphere(3000, 2.0)), opened.workforce
        )
        quadrics = method.fit(partition, opened.workforce, lambda _done, _total: None)
    # Points off their sphere by up to a tenth are put back, and get its normals.
    radii = np.linspace(0.9, 1.1, 3000)[:, None]
    shaken = PointCloud(partition.points.positions * radii, partition.points.normals)
    placed = project_points(type(partition)(shaken, partition.patches), quadrics)
    assert np.linalg.norm(placed.positions, axis=1) == pytest.approx(2.0, abs=1e-6)
    assert placed.normals is not None
    assert placed.normals == pytest.approx(placed.positions / 2.0, abs=1e-6)


@pytest.mark.parametrize("size", [0.5, 1.0])
def test_discs_lie_across_the_normals_and_have_both_sides(size: float) -> None:
    points = make_sphere(50, 2.0)
    discs = build_discs(points, np.array([[10, 20, 30]], np.uint8), size)
    a, b, c = (discs.vertices[discs.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert points.normals is not None
    outward = np.repeat(points.normals, 2, axis=0)
    assert normals == pytest.approx(np.concatenate([outward, -outward]), abs=1e-9)
    assert discs.colours is not None
    assert discs.colours.shape == discs.vertices.shape
