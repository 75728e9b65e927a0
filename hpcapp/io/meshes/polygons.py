"""Polygons of any number of corners, flat, and their triangles. Used by the readers of meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io.columns import Ragged, cut_fans
from hpcapp.io.frame import to_local
from hpccomponent.errors import InputError


def mesh_of_polygons(vertices: FloatArray, polygons: Ragged, path: Path) -> Mesh:
    """Cut polygons, with indices from 0, into triangle fans; bring vertices into a local frame.

    They are (v, 3) in the file's coordinates. Raise InputError where a polygon has fewer than three
    corners or names a vertex that does not exist.
    """
    lengths, corners = polygons.lengths, polygons.values
    if len(lengths) and not 0 <= lengths.max() <= len(corners) == lengths.sum():
        raise InputError(
            f"{path}: {len(corners)} corners do not make the {len(lengths)} faces",
            "the file is damaged: export it again",
        )
    if (lengths < 3).any():
        face = int(np.argmax(lengths < 3))
        raise InputError(
            f"{path}: face {face} has {lengths[face]} corners", "a face needs at least three"
        )
    wrong = (corners < 0) | (corners >= len(vertices))
    if wrong.any():
        at = int(np.argmax(wrong))
        face = int(np.searchsorted(np.cumsum(lengths), at, side="right"))
        raise InputError(
            f"{path}: face {face} names vertex {corners[at]}, but the file has {len(vertices)}",
            "the file is damaged: export it again",
        )
    faces = corners[cut_fans(lengths)[0]]
    local, origin = to_local(vertices)
    return Mesh(local, faces.astype(np.int64, copy=False), origin)
