"""Loops that are filled with triangles of least area."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.mending.triangulation import triangulate


def make_star(count: int) -> FloatArray:
    """A flat star, which is not convex; its area is that of the triangles from its middle."""
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    radii = np.where(np.arange(count) % 2, 1.0, 2.0)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles), 0.0 * angles], axis=1)


def normals_of(places: FloatArray, faces: IntArray) -> FloatArray:
    a, b, c = places[faces].transpose(1, 0, 2)
    normals: FloatArray = 0.5 * np.cross(b - a, c - a)
    return normals


@pytest.mark.parametrize("count", [4, 10, 60, 256, 258, 900])
def test_a_flat_loop_is_covered_once(count: int) -> None:
    star = make_star(count)
    faces = triangulate(star, np.zeros_like(star))
    assert faces is not None
    assert faces.shape == (count - 2, 3)
    normals = normals_of(star, faces)
    spanned = 0.5 * np.cross(star, np.roll(star, -1, axis=0))[:, 2].sum()
    assert normals[:, 2].sum() == pytest.approx(spanned)
    if count <= 256:
        assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(spanned)
    sides = {(int(a), int(b)) for face in faces for a, b in pairwise([*face, face[0]])}
    assert len(sides) == 3 * len(faces)
    assert all((one, (one + 1) % count) in sides for one in range(count))


def test_no_edge_is_one_that_is_there() -> None:
    hexagon = make_star(12)[::2]
    taken = {(0, 2), (2, 4), (0, 4), (1, 3)}
    faces = triangulate(hexagon, np.zeros_like(hexagon), taken)
    assert faces is not None
    edges = {
        tuple(sorted((int(a), int(b)))) for face in faces for a, b in pairwise([*face, face[0]])
    }
    assert not edges & taken
    assert triangulate(hexagon[:4], np.zeros((4, 3)), {(0, 2), (1, 3)}) is None


def test_a_bent_loop_is_filled_the_short_way() -> None:
    """Of the two ways to fill four corners of a roof, the one along its ridge is shorter."""
    roof = np.array([[0.0, 0, 0], [5, 0, 1], [10, 0, 0], [5, 1, 1]])
    faces = triangulate(roof, np.zeros_like(roof))
    assert faces is not None
    assert sorted(map(sorted, faces.tolist())) == [[0, 1, 3], [1, 2, 3]]
