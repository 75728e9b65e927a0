"""Pictures that are laid on a mesh."""

from __future__ import annotations

from hpcapp.geometry.points import ByteArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A texture of a mesh with v vertices, whose rows stand beside those of the vertices.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 2)
        Where each vertex lies in the pictures: right and down, 0 to 1.
    tangents : ndarray of float64, shape (v, 4)
        Unit vectors in which the pictures go right; the last column is 1 where the cross product
        of normal and tangent goes up in them, and -1 where it goes down.
    colours : ndarray of uint8, shape (p, p, 3), or None
        sRGB, row by row from the top.
    normals : ndarray of uint8, shape (p, p, 3)
        Of the fine surface, in the frame of tangent, up and normal; -1 to 1 as 0 to 255.
    sources : ndarray of int64, shape (v,)
        Which vertex each was before the mesh was cut into charts.
    """

    places: FloatArray
    tangents: FloatArray
    colours: ByteArray | None
    normals: ByteArray
    sources: IntArray
