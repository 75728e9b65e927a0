"""Small handles are found wherever they lie; wide ones, and none, are not."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.stitching.handles import SmallHandles, find_small_handles
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.io.meshes.mesh_stream import as_stream


def skin(solid: BoolArray) -> Mesh:
    """The surface of some unit cubes."""
    vertices: dict[tuple[int, ...], int] = {}
    faces = []
    padded = np.pad(solid, 1)
    for axis in range(3):
        for step in (-1, 1):
            bare = padded & ~np.roll(padded, -step, axis)
            along = np.roll(np.eye(3, dtype=int), -axis, axis=0)
            for place in np.argwhere(bare):
                corner = place + max(step, 0) * along[0]
                ring = [corner, corner + along[1], corner + along[1] + along[2], corner + along[2]]
                quad = [vertices.setdefault(tuple(c), len(vertices)) for c in ring[::step]]
                faces += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
    mesh = Mesh(np.array(list(vertices), float), np.array(faces))
    assert check_mesh(mesh).watertight
    return mesh


def find(mesh: Mesh, shift: FloatArray | float = 0.0) -> SmallHandles:
    return find_small_handles(as_stream(Mesh(mesh.vertices + shift, mesh.faces)))


def block(width: int, places: tuple[tuple[int, int], ...] = ((20, 20),)) -> BoolArray:
    """A block with grooves as wide as some cubes, each with a bridge of two cubes across."""
    solid = np.ones((48, 48, 6), np.bool_)
    for x, y in places:
        solid[x : x + width, y - 3 : y + 5, 4:] = False
        solid[x : x + width, y : y + 2, 5] = True
    return solid


def test_no_handle_is_found_in_a_block_without_one() -> None:
    assert find(skin(block(0))).count == 0


@pytest.mark.parametrize("shift", range(0, 8, 3))
@pytest.mark.parametrize("at", range(16, 24, 3))
def test_a_bridge_over_a_narrow_groove_is_found_wherever_it_lies(shift: int, at: int) -> None:
    found = find(skin(block(2, ((at, at),))), float(shift))
    assert found.count == 1
    middle = np.array([at + 2.0, at + 2.0, 6.0]) + shift
    assert np.abs(found.place - middle).max() < found.width


@pytest.mark.parametrize(("width", "count"), [(4, 1), (10, 0), (16, 0)])
def test_a_bridge_over_a_wide_groove_was_scanned(width: int, count: int) -> None:
    mesh = skin(block(width))
    assert check_mesh(mesh).genus == 1
    assert find(mesh).count == count


def test_a_hole_through_a_plate_was_scanned() -> None:
    """However narrow it is, the way around it leads around the plate."""
    solid = np.ones((40, 40, 2), np.bool_)
    solid[20:22, 20:22] = False
    mesh = skin(solid)
    assert check_mesh(mesh).genus == 1
    assert find(mesh).count == 0


def test_each_bridge_counts_once() -> None:
    assert find(skin(block(2, ((8, 8), (8, 36), (36, 8))))).count == 3
