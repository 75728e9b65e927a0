"""Which bricks the surface passes through: seeded at the points, grown across sign changes.

A tile grows its own bricks, those that hold points of its own, and what the surface reaches from
them; where it comes upon bricks of other tiles, these make its rim: they are evaluated, because
vertices are balanced among the faces on both sides, but belong to the other tile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.fitting.blending import NODES
from hpccomponent.surface.fitting.field import BRICK, Grid
from hpccomponent.surface.types.lattice import (
    cells_of,
    find_keys,
    pack_places,
    step_keys,
    unique_keys,
    unpack_keys,
)
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = [
    "BESIDE",
    "FOREIGN",
    "OPEN",
    "OUT",
    "OWN",
    "BrickKinds",
    "grow_bricks",
    "seed_bricks",
]

Float32Array = NDArray[np.float32]
Evaluate = Callable[[IntArray], Float32Array]

OUT, BESIDE, FOREIGN, OPEN, OWN = range(5)
"""What a brick is to a tile: out of its reach; without points, but not to be taken; another
tile's; without points, and taken when the surface reaches it; its own."""


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
    kinds: NDArray[np.uint8]

    def at(self, keys: IntArray) -> NDArray[np.uint8]:
        """Return the kinds of some bricks."""
        places = unpack_keys(keys) - self.first
        inside = ((places >= 0) & (places < self.kinds.shape)).all(axis=1)
        found = np.full(len(keys), OUT, np.uint8)
        x, y, z = places[inside].T
        found[inside] = self.kinds[x, y, z]
        return found

    def mark(self, keys: IntArray, kind: int) -> None:
        """Set the kind of some bricks; of those outside the box it is `OUT`, whatever is set."""
        places = unpack_keys(keys) - self.first
        places = places[((places >= 0) & (places < self.kinds.shape)).all(axis=1)]
        self.kinds[tuple(places.T)] = kind

    def own(self) -> IntArray:
        """Return the keys of the tile's own bricks, sorted."""
        return pack_places(np.argwhere(self.kinds == OWN) + self.first)


def seed_bricks(grid: Grid, positions: FloatArray) -> IntArray:
    """Return the bricks that hold a point.

    Parameters
    ----------
    grid : Grid
    positions : ndarray of float64, shape (n, 3)
        In length units of the input, inside the grid.

    Returns
    -------
    ndarray of int64, shape (b,)
        Sorted, unique keys.
    """
    places = np.floor(cells_of(positions, grid.origin, BRICK * grid.step)).astype(np.int64)
    return unique_keys(pack_places(places))


def grow_bricks(
    evaluate: Evaluate, kinds: BrickKinds, bricks: tuple[int, int, int]
) -> tuple[IntArray, Float32Array, NDArray[np.bool_], IntArray]:
    """Evaluate a tile's own bricks, all open ones that the surface reaches, and their rim.

    Parameters
    ----------
    evaluate : callable
        From places of bricks, shape (b, 3), to their node values, shape (b, 9, 9, 9).
    kinds : BrickKinds
    bricks : tuple of int
        Bricks of the grid along x, y and z.

    Returns
    -------
    places : ndarray of int64, shape (b, 3)
        Sorted.
    values : ndarray of float32, shape (b, 9, 9, 9)
    taken : ndarray of bool, shape (b,)
        False for the rim.
    exits : ndarray of int64, shape (e,)
        Sorted keys of bricks that the surface reaches, and that are `BESIDE` or `OUT`.

    Notes
    -----
    No edge that the surface crosses lies on a brick that no tile has, once the exits are grown
    too, so the surface is closed; the cost grows with its area. The rim is what the surface
    reaches among the 26 neighbours of what is taken: six cells deep at least.
    """
    part, beyond = _Grown(evaluate, bricks), [np.empty(0, np.int64)]
    new = kinds.own()
    while len(new):
        reached = part.add(new)
        found = kinds.at(reached)
        new = np.setdiff1d(reached[(found == OWN) | (found == OPEN)], part.keys())
        beyond.append(reached[(found != OWN) & (found != OPEN)])
    taken = part.keys()
    edge = unique_keys(np.concatenate(beyond))
    exits = edge[np.isin(kinds.at(edge), (OUT, BESIDE))]
    new = edge[kinds.at(edge) != OUT]
    while len(new):
        reached = np.setdiff1d(part.add(new), part.keys())
        new = reached[(kinds.at(reached) != OUT) & _touch(reached, taken)]
    keys, values = part.sorted()
    return unpack_keys(keys), values, np.isin(keys, taken), exits


class _Grown:
    """Bricks that are evaluated."""

    def __init__(self, evaluate: Evaluate, bricks: tuple[int, int, int]) -> None:
        self._evaluate = evaluate
        self._bricks = bricks
        self._keys: list[IntArray] = [np.empty(0, np.int64)]
        self._values: list[Float32Array] = [np.empty((0, *[NODES] * 3), np.float32)]

    def add(self, keys: IntArray) -> IntArray:
        """Evaluate bricks and return those behind the faces on which the sign changes."""
        values = self._evaluate(unpack_keys(keys))
        self._keys.append(keys)
        self._values.append(values)
        return _reached(keys, values, self._bricks)

    def keys(self) -> IntArray:
        """Return all, sorted."""
        return unique_keys(np.concatenate(self._keys))

    def sorted(self) -> tuple[IntArray, Float32Array]:
        """Return all with their values, sorted."""
        joined = np.concatenate(self._keys)
        order = np.argsort(joined, kind="stable")
        return joined[order], np.concatenate(self._values)[order]


def _touch(keys: IntArray, others: IntArray) -> NDArray[np.bool_]:
    """Tell which bricks have one of the others among their 26 neighbours."""
    touched = np.zeros(len(keys), np.bool_)
    for step in np.ndindex(3, 3, 3):
        touched |= find_keys(others, step_keys(keys, np.array(step) - 1)) < len(others)
    return touched


def _reached(keys: IntArray, values: Float32Array, bricks: tuple[int, int, int]) -> IntArray:
    """Return the bricks behind the faces on which the sign changes."""
    inside = values < 0.0
    places = unpack_keys(keys)
    reached = []
    for axis in range(3):
        for step, layer, last in ((-1, 0, 0), (1, NODES - 1, bricks[axis] - 1)):
            face = np.take(inside, layer, axis=axis + 1).reshape(len(keys), NODES**2)
            crossed = face.any(axis=1) & ~face.all(axis=1) & (places[:, axis] != last)
            reached.append(step_keys(keys[crossed], step * np.eye(3, dtype=np.int64)[axis]))
    return unique_keys(np.concatenate(reached))
