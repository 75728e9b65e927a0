"""The evaluation grid, its bricks, and what a brick is to a tile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcapp.applications.surface.types.lattice import pack_places, unpack_keys
from hpcapp.applications.surface.types.points import ByteArray, FloatArray, IntArray

__all__ = ["BESIDE", "BRICK", "FOREIGN", "NODES", "OPEN", "OUT", "OWN", "BrickKinds", "Grid"]

NODES = 9
"""Nodes along the edge of a brick."""


BRICK = NODES - 1
"""Cells along the edge of a brick."""


OUT, BESIDE, FOREIGN, OPEN, OWN = range(5)
"""What a brick is to a tile: out of its reach; without points, but not to be taken; another
tile's; without points, and taken when the surface reaches it; its own."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The evaluation grid.

    Parameters
    ----------
    origin : ndarray of float64, shape (3,)
        Where node (0, 0, 0) lies.
    step : float
        Edge of a cell, in length units of the input.
    bricks : tuple of int
        Along x, y and z.
    """

    origin: FloatArray
    step: float
    bricks: tuple[int, int, int]

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """The first node and the last, in length units of the input."""
        return self.origin, self.origin + self.step * BRICK * np.array(self.bricks)


@dataclass(frozen=True, slots=True, eq=False)
class BrickKinds:
    """What the bricks of a box of the grid are to a tile; all others are `OUT`.

    Parameters
    ----------
    first : ndarray of int64, shape (3,)
        The lowest brick of the box.
    kinds : ndarray of uint8, shape (x, y, z)
    """

    first: IntArray
    kinds: ByteArray

    def at(self, keys: IntArray) -> ByteArray:
        """Return the kinds of some bricks."""
        places = unpack_keys(keys) - self.first
        inside = ((places >= 0) & (places < self.kinds.shape)).all(axis=1)
        kinds = np.full(len(keys), OUT, np.uint8)
        x, y, z = places[inside].T
        kinds[inside] = self.kinds[x, y, z]
        return kinds

    def mark(self, keys: IntArray, kind: int) -> None:
        """Set the kind of some bricks; of those outside the box it is `OUT`, whatever is set.

        Parameters
        ----------
        keys : ndarray of int64, shape (k,)
        kind : int
            Such as `OWN`.
        """
        places = unpack_keys(keys) - self.first
        places = places[((places >= 0) & (places < self.kinds.shape)).all(axis=1)]
        self.kinds[tuple(places.T)] = kind

    def own(self) -> IntArray:
        """Return the keys of the tile's own bricks, sorted."""
        return pack_places(np.argwhere(self.kinds == OWN) + self.first)
