"""The evaluation grid, its bricks, and what a brick is to a tile."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import find_keys, pack_places, unpack_keys
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

MOST_SHIFT = 3
"""Of a stride of one brick, as a power of two."""


BRICK = 1 << MOST_SHIFT
"""Cells along the edge of a brick."""


NODES = BRICK + 1
"""Nodes along the edge of a brick."""


OUT, BESIDE, FOREIGN, OPEN, OWN = range(5)
"""What a brick is to a tile: out of its reach; without points, but not to be taken; another
tile's; without points, and taken when the surface reaches it; its own."""


@record("surface.brick_strides")
@dataclass(frozen=True, slots=True, eq=False)
class BrickStrides:
    """How far apart the nodes of each brick are: 1, 2, 4 or 8 finest steps.

    The strides of bricks of sorted `keys` (k,) are two to the power of `exponents` (k,), 0 to
    `MOST_SHIFT`; that of all others is `rest`.
    """

    keys: IntArray
    exponents: ByteArray
    rest: int = MOST_SHIFT

    def at(self, keys: IntArray) -> ByteArray:
        """Return the exponents of some bricks, of the shape of `keys`."""
        return np.append(self.exponents, np.uint8(self.rest))[find_keys(self.keys, keys)]

    def cells_within(self, first: IntArray, sides: tuple[int, ...]) -> ByteArray:
        """Return how many cells the bricks of a box have along an edge.

        `first` (3,) is the lowest brick, and `sides` are bricks along x, y and z.
        """
        places = unpack_keys(self.keys) - first
        inside = ((places >= 0) & (places < sides)).all(axis=1)
        cells = np.full(sides, BRICK >> self.rest, np.uint8)
        cells[tuple(places[inside].T)] = np.uint8(BRICK) >> self.exponents[inside]
        return cells


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The evaluation grid, of bricks along x, y and z; node (0, 0, 0) lies at the origin.

    A step is the edge of a cell; by default all strides are 1. Of the nodes inside a brick only
    those exist whose places in it are multiples of its stride; on a face, or an edge, of several
    bricks, those of the finest of them. A cell is as large as the stride of its brick.
    """

    origin: FloatArray
    step: float
    bricks: tuple[int, int, int]
    strides: BrickStrides | None = None

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """The first node and the last, in length units of the input."""
        return self.origin, self.origin + self.step * BRICK * np.array(self.bricks)

    @property
    def rim(self) -> int:
        """How many bricks deep the rim of a tile is at most (see `kernels.mark_rim`)."""
        return 1 if self.strides is None else 1 << MOST_SHIFT


@dataclass(frozen=True, slots=True, eq=False)
class BrickKinds:
    """What the bricks of a box of the grid are to a tile, (x, y, z); all others are `OUT`.

    `first` (3,) is the lowest brick of the box.
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
        """Set the kind, such as `OWN`, of some bricks; those outside the box stay `OUT`."""
        places = unpack_keys(keys) - self.first
        places = places[((places >= 0) & (places < self.kinds.shape)).all(axis=1)]
        self.kinds[tuple(places.T)] = kind

    def own(self) -> IntArray:
        """Return the keys of the tile's own bricks, sorted."""
        return pack_places(np.argwhere(self.kinds == OWN) + self.first)
