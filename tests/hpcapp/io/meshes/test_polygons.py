from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.io.columns import Ragged
from hpcapp.io.meshes.polygons import mesh_of_polygons


@settings(deadline=None)  # a busy machine is no fault
@given(st.lists(st.integers(3, 12), min_size=1, max_size=8))
def test_fans_cover_their_polygons_and_keep_their_sense(corners: list[int]) -> None:
    rings = []
    for ring, n in enumerate(corners):
        angle = np.arange(n) * 2 * np.pi / n
        rings.append(np.stack([np.cos(angle), np.sin(angle), np.full(n, float(ring))], axis=1))
    lengths = np.array(corners)
    mesh = mesh_of_polygons(
        np.vstack(rings), Ragged(lengths, np.arange(lengths.sum())), Path("a.ply")
    )
    a, b, c = mesh.vertices[mesh.faces.T]
    areas = np.cross(b - a, c - a)[:, 2] / 2
    expected = sum(n / 2 * np.sin(2 * np.pi / n) for n in corners)
    assert len(mesh.faces) == sum(n - 2 for n in corners)
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(expected)


def test_no_polygons_are_no_triangles() -> None:
    nothing = Ragged(np.empty(0, np.int64), np.empty(0, np.int64))
    assert mesh_of_polygons(np.eye(3), nothing, Path("a.ply")).faces.shape == (0, 3)
