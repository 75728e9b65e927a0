"""Which bricks the surface passes through: seeded at the points, grown across sign changes.

A tile grows its own bricks, those that hold points of its own, and what the surface reaches from
them; where it comes upon bricks of other tiles, these make its rim: they are evaluated, because
vertices are balanced among the faces on both sides, but belong to the other tile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hpcapp.geometry.lattice import cells_of, pack_places, step_keys, unique_keys, unpack_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels.portable.field.field import evaluate_bricks
from hpcapp.kernels.portable.surface.marching_cubes import extract_surface
from hpcapp.kernels.portable.surface.rims import mark_rim
from hpcapp.kernels.types.brick_mesh import BrickMesh
from hpcapp.kernels.types.field import Field
from hpcapp.kernels.types.grid import (
    BESIDE,
    BRICK,
    NODES,
    OPEN,
    OUT,
    OWN,
    BrickKinds,
    BrickStrides,
    Grid,
)

__all__ = ["grow_surface", "seed_bricks"]

Evaluate = Callable[[IntArray], Float32Array]


def seed_bricks(grid: Grid, positions: FloatArray) -> IntArray:
    """Return the bricks that hold points (n, 3) inside the grid: sorted, unique keys (b,)."""
    places = np.floor(cells_of(positions, grid.origin, BRICK * grid.step)).astype(np.int64)
    return unique_keys(pack_places(places))


def grow_bricks(
    evaluate: Evaluate,
    kinds: BrickKinds,
    bricks: tuple[int, int, int],
    strides: BrickStrides | None = None,
) -> tuple[IntArray, Float32Array, BoolArray, IntArray]:
    """Evaluate a tile's own bricks, all open ones that the surface reaches, and their rim.

    `evaluate` gives the node values (b, 9, 9, 9) of places of bricks (b, 3); the grid has `bricks`
    along x, y and z. Return places, sorted, and values; which are taken, (b,), False for the rim;
    and exits (e,): sorted keys of bricks that the surface reaches, and that are `BESIDE` or `OUT`.

    Notes
    -----
    No edge that the surface crosses lies on a brick that no tile has, once the exits are grown
    too, so the surface is closed; the cost grows with its area. The rim is what the surface
    reaches in `mark_rim` of what is taken.
    """
    part, beyond = _Grown(evaluate, bricks), [np.empty(0, np.int64)]
    new = kinds.own()
    while len(new):
        reached = part.add(new)
        kind = kinds.at(reached)
        may_grow = (kind == OWN) | (kind == OPEN)
        new = np.setdiff1d(reached[may_grow], part.keys())
        beyond.append(reached[~may_grow])
    # What the surface reaches beyond: exits where no tile has the brick, the rim where one has.
    taken = part.keys()
    edge = unique_keys(np.concatenate(beyond))
    exits = edge[np.isin(kinds.at(edge), (OUT, BESIDE))]
    reached = edge[kinds.at(edge) != OUT]
    new = reached
    while len(new):
        further = part.add(new)
        reached = np.union1d(reached, further[kinds.at(further) != OUT])
        # What the surface has come by counts as way to what lies behind.
        rim = _find_rim(kinds, taken, part.keys(), strides)
        new = np.setdiff1d(reached[rim.at(reached) != OUT], part.keys())
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


def _find_rim(
    kinds: BrickKinds, taken: IntArray, evaluated: IntArray, strides: BrickStrides | None
) -> BrickKinds:
    """Mark what is taken and its rim: so few cells of evaluated bricks lie between; else `OUT`."""
    own, ways = (BrickKinds(kinds.first, np.zeros_like(kinds.kinds)) for _ in range(2))
    own.mark(taken, OWN)
    cells = None
    if strides is not None:
        ways.mark(evaluated, OWN)
        inner = strides.cells_within(kinds.first, kinds.kinds.shape)
        cells = np.where(ways.kinds == OWN, inner, np.uint8(BRICK))
    is_rim = mark_rim(own.kinds == OWN, cells)
    return BrickKinds(kinds.first, np.where(is_rim, kinds.kinds, np.uint8(OUT)))


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


def grow_surface(field: Field, grid: Grid, kinds: BrickKinds, threads: int = 1) -> BrickMesh:
    """Extract the surface in a tile's own bricks, and in all that it reaches from them."""
    del threads  # numpy runs on one
    places, values, taken, exits = grow_bricks(
        lambda bricks: evaluate_bricks(field, grid, bricks), kinds, grid.bricks, grid.strides
    )
    return replace(extract_surface(grid, places, values, taken), exits=exits)
