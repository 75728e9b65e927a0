"""What a part gives to the mesh, as tasks are told that cut it open."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.geometry.lattice import are_sampled, find_keys
from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray, Int32Array, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record


@record("surface.taken_bricks")
@dataclass(frozen=True, slots=True, eq=False)
class TakenBricks:
    """The bricks of a part that the mesh takes from it: sorted keys, and vertices of each, (k,).

    `exponents` (k,) are of their strides (see `types.grid.BrickStrides`); the surface lies in a
    `box` (2, 3).
    """

    keys: IntArray
    vertex_counts: Int32Array
    exponents: ByteArray
    box: FloatArray

    @property
    def vertices(self) -> int:
        """How many they have together."""
        return int(self.vertex_counts.sum(dtype=np.int64))

    def areas(self, one_in: int) -> IntArray:
        """Return how large the surface in each is: as so many vertices a finest step apart.

        One in so many bricks counts; the others have 0.
        """
        areas: IntArray = self.vertex_counts.astype(np.int64) << (
            2 * self.exponents.astype(np.int64)
        )
        return np.where(are_sampled(self.keys, one_in), areas, 0)

    def sample(self, one_in: int) -> IntArray:
        """Return the keys of those that count in `areas`."""
        return self.keys[are_sampled(self.keys, one_in)]

    def holds(self, keys: IntArray) -> bool:
        """Tell whether all of some bricks are among these."""
        return bool((find_keys(self.keys, keys) < len(self.keys)).all())

    def mark(self, part: MeshPart) -> BoolArray:
        """Tell which of the bricks of the part these are."""
        marked: BoolArray = find_keys(self.keys, part.bricks) < len(self.keys)
        return marked
