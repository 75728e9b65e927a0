"""Inside and outside of meshes, against shapes of which both are known."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.compare.nearest import NearestFace
from hpcapp.applications.compare.sides import find_sides
from hpcapp.applications.compare.truth import MeshTruth, PointTruth, ShapeTruth
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.lab.simulate.shapes import SHAPES

# A thin wedge: most places near its edge are nearest to the edge itself.
WEDGE = Mesh(
    np.array([[0.0, 0, 0], [3, -0.2, 0], [3, 0.2, 0], [0, 0, 1], [3, -0.2, 1], [3, 0.2, 1]]),
    np.array([
        [0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [0, 3, 5], [0, 5, 2], [1, 2, 5], [1, 5, 4],
    ]),
)  # fmt: skip


def is_inside(points: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    x, y, z = points.T
    return np.asarray((x > 0) & (x < 3) & (np.abs(y) < x / 15) & (z > 0) & (z < 1))


def test_a_sharp_wedge_has_the_sides_that_it_has() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform([-1.0, -1.0, -0.5], [4.0, 1.0, 1.5], (20_000, 3))
    points[:6000] = WEDGE.vertices[rng.integers(0, 6, 6000)] + rng.normal(0, 0.05, (6000, 3))
    sides = find_sides(WEDGE, points, NearestFace(WEDGE).query(points)[1])
    np.testing.assert_array_equal(sides < 0, is_inside(points))


def test_a_truth_with_sides_tells_them() -> None:
    points = np.random.default_rng(5).uniform(-1.5, 1.5, (500, 3))
    inside = np.linalg.norm(points, axis=1) < 1.0
    shape = ShapeTruth(SHAPES["sphere"])
    np.testing.assert_array_equal(shape.find_sides(points) < 0, inside)
    near = np.abs(np.linalg.norm(points, axis=1) - 1.0) > 0.02  # of points the sides are coarse
    scan = PointTruth(shape.sample(20_000, 0))
    found = scan.find_sides(points)
    assert found is not None
    np.testing.assert_array_equal(found[near] < 0, inside[near])


def test_a_truth_that_is_inside_out_has_the_same_sides() -> None:
    points = np.array([[1.0, 0.0, 0.5], [1.0, 0.5, 0.5]])
    turned = MeshTruth(Mesh(WEDGE.vertices, WEDGE.faces[:, ::-1]))
    for truth in (MeshTruth(WEDGE), turned):
        assert truth.find_sides(points) == pytest.approx([-1.0, 1.0])


def test_what_has_no_sides_says_so() -> None:
    assert MeshTruth(Mesh(WEDGE.vertices, WEDGE.faces[1:])).find_sides(np.zeros((1, 3))) is None
    assert PointTruth(PointCloud(WEDGE.vertices)).find_sides(np.zeros((1, 3))) is None
