"""The surface inside some bricks, made in slabs: the finest level never lies there as a whole.

::

    bricks ─> slab: finest quadrics ─> the surface in its bricks ─> MeshPart
               ^        the next one, and again where    │
               └── the surface goes on in another slab <─┘

A slab has whole layers of bricks along x. What it gives is what all bricks at once would give
there, bit for bit: to a slab, a brick of another one is what a brick of another tile is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.extraction.parts import MeshPart, cut_part, join_parts
from hpcapp.applications.surface.extraction.sharpening import sharpen_vertices
from hpcapp.applications.surface.field.levels import SlabFields
from hpcapp.applications.surface.tiles.halo import cut_slab
from hpcapp.geometry.lattice import unique_keys
from hpcapp.geometry.points import IntArray
from hpcapp.kernels.types.brick_mesh import BrickMesh
from hpcapp.kernels.types.grid import FOREIGN, OPEN, OWN, BrickKinds

SLAB_QUADRICS = 150_000
"""Of the finest level, in a slab; no result depends on it.

With a million the whole job of 263 thousand points took 193 MB, with 200,000 of them 157, with
100,000 or fewer 145, at the same CPU time.
"""


def cut_slabs(fields: SlabFields, kinds: BrickKinds, least: int = 1) -> list[int]:
    """Return the bounds of slabs, in layers along x: `least` or more, where there are so many."""
    first = int(kinds.first[0])
    return fields.cut(first, first + len(kinds.kinds), SLAB_QUADRICS, least)


def grow_slabs(
    fields: SlabFields, kinds: BrickKinds, bounds: list[int]
) -> Iterator[tuple[MeshPart, IntArray]]:
    """Extract the surface in a tile's own bricks, and in all that it reaches from them.

    Yield parts of slabs: one that the surface enters from another slab may get several, no brick
    twice; and the sorted keys of the bricks where its surface leaves the tile (see `grow_bricks`).
    """
    untaken = BrickKinds(kinds.first, kinds.kinds.copy())  # those that a part has are another's
    reached = kinds.own()
    while len(reached):
        for first, end in pairwise(bounds):
            slab = cut_slab(fields.grid, untaken, first, end)
            # Open bricks that the surface has entered become the slab's own: it goes on from there.
            slab.mark(reached[slab.at(reached) == OPEN], OWN)
            if not (slab.kinds == OWN).any():
                continue
            mesh = _grow_slab(fields, slab)
            part, exits = cut_part(mesh, kinds, fields.mark_supported(mesh.vertices)), mesh.exits
            del mesh  # makes room for what is made of the part
            untaken.mark(part.bricks, FOREIGN)
            goes_on = kinds.at(exits) == OPEN
            reached = np.concatenate([reached, exits[goes_on]])
            yield part, exits[~goes_on]
        # What no part has by now is left to the next round.
        reached = reached[untaken.at(reached) == OPEN]


def _grow_slab(fields: SlabFields, slab: BrickKinds) -> BrickMesh:
    """Extract the surface in a slab, its vertices in their final places."""
    first, grid = int(slab.first[0]), fields.grid
    field = fields.fit(first, first + len(slab.kinds))
    mesh = kernels.grow_surface(field, grid, slab, fields.threads)
    of_levels, origin, cell_size = field.features, field.origin, field.cell_size
    del field  # makes room for what is made of the mesh
    of_mesh = mesh.vertices, mesh.faces
    of_faces, steps = None, np.broadcast_to(grid.step, len(mesh.vertices))
    if grid.strides is not None:
        # (b,): how often the step is doubled in each brick; then of its faces and vertices.
        exponents = grid.strides.at(mesh.bricks)
        of_faces = np.repeat(exponents, mesh.face_counts)
        steps = grid.step * 2.0 ** np.repeat(exponents, mesh.vertex_counts)
    # (v, 3): evened out, and then, level by level, put on the edges that the fits have found.
    moved = kernels.balance_vertices(*of_mesh, grid.step, of_faces)
    for depth, features in enumerate(of_levels):
        lattice = origin, cell_size * 2.0**depth
        moved = sharpen_vertices(*of_mesh, moved, features, lattice, steps)
    return replace(mesh, vertices=moved)


def grow_tile(fields: SlabFields, kinds: BrickKinds) -> tuple[MeshPart, IntArray]:
    """Extract the surface in a tile's own bricks, and in all that it reaches from them.

    The exits (e,) are as of `grow_slabs`. What `fields` is made of is let go when the last slab is
    there: the part takes its place.
    """
    grown = list(grow_slabs(fields, kinds, cut_slabs(fields, kinds)))
    fields.let_go()
    del fields  # with the levels and the far field, where the caller has handed them over
    exits = unique_keys(np.concatenate([np.empty(0, np.int64), *(exits for _, exits in grown)]))
    return join_parts([part for part, _ in grown]), exits
