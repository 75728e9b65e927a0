"""The surface, tile by tile on the workers, and over the gaps between them until it is quiet.

::

    tiles ── mesh_tile ──> parts, exits ──┐
               exits that no part has ──> mesh_gap ──> parts, exits ──> ... none left
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.coarse import Coarse
from hpcapp.applications.surface.method import Advance
from hpcapp.applications.surface.surface import PartSurface
from hpcapp.applications.surface.tiles import Tiling
from hpcapp.batches import Workforce, map_batches
from hpccomponent.errors import JobError
from hpccomponent.surface.field import BRICK
from hpccomponent.surface.lattice import find_keys, pack_places, unique_keys, unpack_keys
from hpccomponent.surface.mesh_part import MeshPart
from hpccomponent.surface.part_summary import PartSummary
from hpccomponent.surface.points import FloatArray, IntArray
from hpccomponent.surface.region import Plan, Values, mesh_gap, mesh_tile

__all__ = ["mesh_regions"]

_MOST_ROUNDS = 1000  # each goes on by a coarse cell at least; a grid has no more


def mesh_regions(
    tiling: Tiling, coarse: Coarse, workforce: Workforce, advance: Advance, origin: FloatArray
) -> PartSurface:
    """Reconstruct the surface inside all tiles.

    Parameters
    ----------
    tiling : Tiling
    coarse : Coarse
    workforce : Workforce
    advance : callable
        Told (tiles done, tiles in all).
    origin : ndarray of float64, shape (3,)
        Of the cloud's local frame.

    Returns
    -------
    PartSurface
        It holds every brick that the surface reaches.
    """
    values = coarse.plan.to_values()
    batches = []
    for index in range(len(tiling)):
        tile = tiling.tile(index)
        points = (tile.core.to_values(), tile.before.to_values(), tile.after.to_values())
        batches.append((values, *points, coarse.around(tile.cells).to_values()))
    found = _Found(origin)
    for result in map_batches(workforce, mesh_tile, batches, advance):
        found.add(result)
    for _ in range(_MOST_ROUNDS):
        left = found.left()
        if not len(left):
            return found.surface
        near = tiling.near(_cells_around(coarse.plan, left))
        batch = (values, left, tiling.take(near).to_values(), tiling.cells[~near])
        (result,) = map_batches(workforce, mesh_gap, [(*batch, coarse.whole().to_values())])
        found.add(result)
    raise JobError("the surface does not come to an end", "report this, with the point cloud")


class _Found:
    """What tiles have given so far."""

    def __init__(self, origin: FloatArray) -> None:
        self.surface = PartSurface([], [], origin)
        self._exits: list[IntArray] = []

    def add(self, result: Values) -> None:
        """Take what a task returned."""
        part, summary, exits = result
        self.surface.parts.append(MeshPart.from_values(part))
        self.surface.summaries.append(PartSummary.from_values(summary))
        self._exits.append(exits)

    def left(self) -> IntArray:
        """Return the bricks that the surface leaves for, and that no part has."""
        wanted = unique_keys(np.concatenate(self._exits))
        held = unique_keys(np.concatenate([part.bricks for part in self.surface.parts]))
        left: IntArray = wanted[find_keys(held, wanted) == len(held)]
        return left


def _cells_around(plan: Plan, bricks: IntArray) -> IntArray:
    """Return the coarse cells that some bricks lie in, empty or not."""
    size = plan.cell_size * 2.0**plan.coarse
    edge = BRICK * plan.step
    low = plan.grid_origin + edge * unpack_keys(bricks) - plan.origin
    first = np.floor(low / size).astype(np.int64)
    span = int(np.ceil(edge / size)) + 1
    steps = np.stack(np.meshgrid(*[np.arange(span)] * 3), axis=-1).reshape(-1, 1, 3)
    return unique_keys(pack_places(first + steps).reshape(-1))
