"""The surface inside the bricks of one tile, with what it shares with others named, not copied."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.bricks import OWN, BrickKinds
from hpccomponent.surface.extraction import BrickMesh
from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["Int32Array", "MeshPart", "cut_part"]

Int32Array = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """The vertices and faces of some bricks; b bricks, v vertices, f faces, g foreign vertices.

    Parameters
    ----------
    bricks : ndarray of int64, shape (b,)
        Keys of places on the evaluation grid (see `lattice.pack_places`), sorted, unique.
    guests : ndarray of bool, shape (b,)
        A brick of another tile that this tile's surface reached, and whose owner may not know of
        it: it holds no point.
    vertex_counts : ndarray of int32, shape (b,)
        How many vertices each brick has.
    face_counts : ndarray of int32, shape (b,)
        How many faces each brick has.
    vertices : ndarray of float64, shape (v, 3)
        Brick by brick, in their final places; in length units of the input, in the local frame.
    faces : ndarray of int32, shape (f, 3)
        Brick by brick, anticlockwise as seen from outside: i >= 0 is a row of `vertices`, i < 0
        the foreign vertex ~i.
    foreign_bricks : ndarray of int64, shape (g,)
        The brick of each foreign vertex, none of them in `bricks`.
    foreign_numbers : ndarray of int32, shape (g,)
        Its number within its brick; (brick, number) are sorted and unique.

    Notes
    -----
    A vertex belongs to the brick of the lower node of its edge. What two parts share is
    bit-identical. A brick that some part owns is taken from there, else from the lowest-numbered
    part that has it as a guest; a face that refers to a vertex of another copy means the vertex
    of that number in the copy that is taken.
    """

    bricks: IntArray
    guests: NDArray[np.bool_]
    vertex_counts: Int32Array
    face_counts: Int32Array
    vertices: FloatArray
    faces: Int32Array
    foreign_bricks: IntArray
    foreign_numbers: Int32Array

    def to_values(self) -> tuple[Any, ...]:
        """Return the arrays, in the order of the parameters: what a task may return."""
        return tuple(getattr(self, field.name) for field in fields(self))

    @classmethod
    def from_values(cls, values: tuple[Any, ...]) -> MeshPart:
        """Return the part that `to_values` took apart."""
        return cls(*values)

    @classmethod
    def empty(cls) -> MeshPart:
        """Return a part without bricks."""
        none = np.empty(0, np.int32)
        keys = np.empty(0, np.int64)
        places, corners = np.empty((0, 3)), np.empty((0, 3), np.int32)
        return cls(keys, np.empty(0, np.bool_), none, none, places, corners, keys, none)


def cut_part(mesh: BrickMesh, kinds: BrickKinds | None = None) -> MeshPart:
    """Cut the rim off the surface of a tile; what its faces use of it is named.

    Parameters
    ----------
    mesh : BrickMesh
    kinds : BrickKinds, optional
        All bricks that hold points are the tile's own where it is left out.

    Returns
    -------
    MeshPart
    """
    taken = mesh.taken
    bricks = mesh.bricks[taken]
    guests = np.zeros(len(bricks), np.bool_) if kinds is None else kinds.at(bricks) != OWN
    is_inner = np.repeat(taken, mesh.vertex_counts)
    rows = np.cumsum(is_inner, dtype=np.int32) - np.int32(1)
    rows[~is_inner] = -1
    faces = mesh.faces.take(np.flatnonzero(np.repeat(taken, mesh.face_counts)), axis=0)
    corners = rows.take(faces)
    outside = np.flatnonzero(corners < 0)
    outer, names = np.unique(faces.reshape(-1)[outside], return_inverse=True)
    corners.reshape(-1)[outside] = ~names
    starts = np.cumsum(mesh.vertex_counts, dtype=np.int64) - mesh.vertex_counts
    owners = np.searchsorted(starts + mesh.vertex_counts, outer, side="right")
    return MeshPart(
        bricks,
        guests,
        mesh.vertex_counts[taken],
        mesh.face_counts[taken],
        mesh.vertices.take(np.flatnonzero(is_inner), axis=0),
        corners,
        mesh.bricks[owners],
        (outer - starts[owners]).astype(np.int32),
    )
