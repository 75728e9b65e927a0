"""Small handles are found wherever they lie; wide ones, and none, are not."""

from __future__ import annotations

import numpy as np
import pytest
from voxels import block, skin

from hpcapp.applications.surface.stitching.handles import BOX, find_small_handles, measure_side
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray


def find(mesh: Mesh, shift: FloatArray | float = 0.0) -> list[IntArray]:
    corners = (mesh.vertices + shift)[mesh.faces]
    return find_small_handles(mesh.faces, corners, BOX * measure_side(corners))


def test_no_handle_is_found_in_a_block_without_one() -> None:
    assert find(skin(block(0))) == []


@pytest.mark.parametrize("shift", range(0, 8, 3))
@pytest.mark.parametrize("at", range(16, 24, 3))
def test_a_bridge_over_a_narrow_groove_is_found_wherever_it_lies(shift: int, at: int) -> None:
    mesh = skin(block(2, ((at, at),)))
    pieces = find(mesh, float(shift))
    assert pieces
    width = BOX * measure_side(mesh.vertices[mesh.faces])
    for piece in pieces:
        middle = mesh.vertices[mesh.faces[piece]].mean(axis=(0, 1))
        assert np.abs(middle - np.array([at + 2.0, at + 2.0, 6.0])).max() < width


@pytest.mark.parametrize(("width", "is_found"), [(4, True), (10, False), (16, False)])
def test_a_bridge_over_a_wide_groove_was_scanned(width: int, is_found: bool) -> None:
    mesh = skin(block(width))
    assert check_mesh(mesh).genus == 1
    assert bool(find(mesh)) == is_found


def test_a_hole_through_a_plate_was_scanned() -> None:
    """However narrow it is, the way around it leads around the plate."""
    solid = np.ones((40, 40, 2), np.bool_)
    solid[20:22, 20:22] = False
    mesh = skin(solid)
    assert check_mesh(mesh).genus == 1
    assert not find(mesh)
