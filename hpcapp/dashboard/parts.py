"""Parts of a mesh as a page draws them: few triangles, 16 bits for a coordinate."""

from __future__ import annotations

import struct

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.pages.arrays import quantise
from hpcapp.pages.thin import thin_mesh
from hpcapp.progress import MeshPart

LARGEST = 65535  # what a coordinate of 16 bits can be


def pack_part(part: MeshPart, most: int) -> bytes:
    """Return a part as bytes, without faces that have a vertex of another part.

    Of more than about `most` triangles a thinned copy is kept. Little-endian: the step (float64),
    the low corner (3 float64), v and f (uint32), the places in steps from the low corner (v x 3
    uint16, filled up to four bytes) and the faces (f x 3 uint32). Empty where nothing is left.
    """
    faces = np.asarray(part.faces)
    whole = Mesh(
        np.asarray(part.vertices), faces[(faces >= 0).all(axis=1)].astype(np.int64), np.zeros(3)
    )
    mesh = thin_mesh(whole, most)
    if not len(mesh.faces):
        return b""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    step = (float((high - low).max()) or 1.0) / LARGEST
    places = quantise(mesh.vertices, low, high).astype("<u2").tobytes()
    return b"".join(
        (
            struct.pack("<4d2I", step, *low.tolist(), len(mesh.vertices), len(mesh.faces)),
            places.ljust(-(-len(places) // 4) * 4, b"\0"),
            mesh.faces.astype("<u4").tobytes(),
        )
    )
