"""Vectors across triangles: judged by triangles whose areas and directions are known."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.faces import cross_edges


def test_a_triangle_on_the_floor_points_up_and_its_back_down() -> None:
    floor = np.array([[5.0, 6.0, 7.0], [8.0, 6.0, 7.0], [5.0, 10.0, 7.0]])
    assert cross_edges(np.stack([floor, floor[::-1]])).tolist() == [[0, 0, 12], [0, 0, -12]]


def test_base_times_height_along_the_third_axis_of_a_right_handed_frame() -> None:
    rng = np.random.default_rng(0)
    x, y, z = np.linalg.qr(rng.normal(size=(500, 3, 3)))[0].transpose(1, 0, 2)
    right = np.linalg.det(np.stack([x, y, z], axis=1))[:, None]  # 1 or -1
    base, height, foot = rng.uniform(0.1, 3.0, (3, 500, 1))
    start = rng.normal(size=(500, 3))
    corners = np.stack([start, start + base * x, start + foot * x + height * y], axis=1)
    for first in range(3):
        vectors = cross_edges(np.roll(corners, first, axis=1))
        np.testing.assert_allclose(vectors, right * base * height * z, atol=1e-12)


def test_triangles_without_an_area_have_no_vector() -> None:
    a, b = np.array([1.0, 2.0, 3.0]), np.array([4.0, 6.0, 9.0])
    corners = np.array([[a, a, a], [a, a, b], [a, b, b], [a, b, a], [a, b, 2.0 * b - a]])
    assert not cross_edges(corners).any()
    assert cross_edges(np.empty((0, 3, 3))).shape == (0, 3)
