"""The faces of a PLY file: which of its lists they are, and the normals that they give."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.io.columns import Numbers, Ragged, cut_fans
from hpcapp.io.ply.header import Header
from hpccomponent.errors import InputError

_FACE_LISTS = ("vertex_indices", "vertex_index")


def find_polygons(header: Header) -> str | None:
    """Return the name of the list of element ``face`` that holds the corners of polygons.

    None where there is no such element or list, or its numbers are not whole.
    """
    face = header.find("face")
    lists = {} if face is None else {p.name: p.dtype for p in face.lists}
    return next((name for name in _FACE_LISTS if lists.get(name, "f")[0] in "iu"), None)


def vertex_normals(
    positions: FloatArray, polygons: Iterable[Ragged], path: Path
) -> tuple[FloatArray, BoolArray]:
    """Add up the area vectors of polygons, some at a time with indices from 0, at each vertex.

    Return normals (n, 3) of any length, as larger polygons weigh more, and which vertices have a
    face, (n,). Raise InputError where a polygon names a vertex that does not exist.
    """
    normals, has_face = np.zeros_like(positions), np.zeros(len(positions), np.bool_)
    for part in polygons:
        corners = _check_corners(part, len(positions), path)
        areas = np.repeat(_area_vectors(positions, part.lengths, corners), part.lengths, axis=0)
        has_face[corners] = True
        for target, weights in zip(normals.T, areas.T, strict=True):
            np.add.at(target, corners, weights)
    return normals, has_face


def _check_corners(polygons: Ragged, vertices: int, path: Path) -> NDArray[np.int64]:
    corners: Numbers = polygons.values
    wrong = (corners < 0) | (corners >= vertices)
    if wrong.any():
        raise InputError(
            f"{path}: a face names vertex {corners[np.argmax(wrong)]}, but the file has {vertices}",
            "the file is damaged: export it again",
        )
    return corners.astype(np.int64)


def _area_vectors(
    positions: FloatArray, lengths: NDArray[np.int64], corners: NDArray[np.int64]
) -> FloatArray:
    """Return the area vector of each polygon, the sum of those of the triangles of its fan."""
    triangles, polygon = cut_fans(lengths)
    with np.errstate(over="ignore", invalid="ignore"):  # vertices may be NaN, or far beyond all
        areas = cross_edges(positions[corners[triangles]])
    vectors = [np.bincount(polygon, column, len(lengths)) for column in areas.T]
    return np.stack(vectors, axis=1) / 2
