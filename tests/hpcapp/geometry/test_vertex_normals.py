from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.geometry.vertex_normals import add_face_normals, scale_normals

CORNERS = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [9, 9, 9], [0, 0, 3]], float)


def sum_up(faces: list[list[int]], at_once: int) -> FloatArray:
    sums, table = np.zeros((3, len(CORNERS))), np.array(faces)
    for start in range(0, len(table), at_once):
        some = table[start : start + at_once]
        add_face_normals(sums, some, CORNERS[some])
    return sums


def test_faces_count_by_their_areas() -> None:
    # A floor of area 2, and a wall of area 1.5 that shares the corner 0 with it.
    normals = scale_normals(sum_up([[0, 1, 2], [0, 2, 3], [0, 3, 5]], 8))
    np.testing.assert_allclose(normals[1], [0, 0, 1])
    np.testing.assert_allclose(normals[5], [1, 0, 0])
    np.testing.assert_allclose(normals[0], np.array([1.5, 0, 2]) / 2.5)


def test_a_vertex_without_faces_has_no_normal() -> None:
    assert not scale_normals(sum_up([[0, 1, 2]], 1))[4].any()


def test_blocks_of_any_size_give_the_same_bits() -> None:
    rng = np.random.default_rng(0)
    faces = rng.integers(0, len(CORNERS), (500, 3)).tolist()
    one, other = sum_up(faces, 500), sum_up(faces, 7)
    assert one.tobytes() == other.tobytes()
