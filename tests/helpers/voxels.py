"""Meshes of unit cubes, with and without small handles."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray


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


def block(width: int, places: tuple[tuple[int, int], ...] = ((20, 20),)) -> BoolArray:
    """A block with grooves as wide as some cubes, each with a bridge of two cubes across."""
    solid = np.ones((48, 48, 6), np.bool_)
    for x, y in places:
        solid[x : x + width, y - 3 : y + 5, 4:] = False
        solid[x : x + width, y : y + 2, 5] = True
    return solid
