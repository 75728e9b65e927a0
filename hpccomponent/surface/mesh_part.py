"""The surface inside the bricks of one tile, with what it shares with others named, not copied."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["Int32Array", "MeshPart"]

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
