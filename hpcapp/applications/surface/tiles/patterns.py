"""What the tasks that make a surface declare of their results."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.extraction.part_places import starts_of
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import PartSummary
from hpcapp.applications.surface.field.far_field import (
    FAR_REACH,
    FarFieldPart,
    crop_nodes,
    lay_far_field,
)
from hpcapp.applications.surface.tiles.plan import CoarseLattice, CoarseLevels, Samples, TilePlan
from hpcapp.applications.surface.tiles.points import estimate_work
from hpcapp.applications.surface.types.result_patterns import (
    SMALL_BYTES,
    Box,
    cells_in,
    keys_within,
    lie_within,
    rise_by_pairs,
)
from hpcapp.geometry.lattice import ancestor_keys, find_keys, unique_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels.types.grid import BRICK
from hpccomponent.protocol.columns import Bounds, Column, pattern_of
from hpccomponent.protocol.declared import Declared, Exactly, Fixed, Nothing, Number, Where, Whole

MOST_VERTICES, MOST_FACES = 3 * BRICK**3, 5 * BRICK**3
"""Of a brick: a vertex on each edge, five faces in each cell.

Larger cells have fewer together, also among the finest bricks: of stride 2, 4 and 8, loops on them
have 2112, 888 and 768 vertices at most."""

Exits = Annotated[IntArray, Column("exits", rises=True)]
"""Bricks where the surface leaves a tile and there are no points (see `bricks`)."""

_TOLD = tuple(one.name for one in fields(MeshPart) if one.name in PartSummary.__slots__)
_MOST = 1 << 40  # of whatever is counted where the master does not know better
_LARGEST_MOMENT = 4.0  # of a point in a cell of edge 1, around its middle
_ROUNDED = 1.0 + 1e-6
_PART_RULE = "bricks have as many vertices and faces as they count"

# Bytes of a result for each square of the grid that the surface may fill, in coarse cells of two
# finest ones: 6 to 16 are needed on surfaces and 46 in a fog, or up to 5 where the part is kept.
_SENT_SQUARE, _KEPT_SQUARE = 128, 32
_SUMMED_POINT = 768  # of what a tile sums, for each of its points: most often 20 to 70


def surface_box(plan: TilePlan) -> tuple[FloatArray, FloatArray]:
    """Return the box in which all of the surface lies: the grid's, and a brick around it."""
    low, high = plan.grid.box
    return low - BRICK * plan.step, high + BRICK * plan.step


def far_field(plan: TilePlan, *_: Any) -> Declared:
    """Return the pattern of what `tasks.solve_far` finds."""
    origin, step = lay_far_field(*plan.grid.box, plan.far_nodes)
    first, end = crop_nodes(origin, step, plan.far_nodes, *plan.far_box)
    most = FAR_REACH * step * _ROUNDED
    return pattern_of(
        FarFieldPart,
        dict(zip("xyz", (end - first).tolist(), strict=True)),
        values=Bounds(-most, most),
        first=Bounds(first, first),
        nodes=Exactly(plan.far_nodes),
        origin=Bounds(origin, origin),
        step=Number(step, step),
    )


def summed_tile(
    plan: TilePlan,
    _points: Any,
    _ticket: Any = None,
    keep: tuple[str, str] | None = None,
    own: tuple[IntArray, IntArray] | None = None,
    *_: Any,
) -> Declared:
    """Return the pattern of what `tasks.sum_tile` returns, or keeps."""
    total = _MOST if own is None else int(own[1].sum())
    if keep is not None:
        place, name = keep
        return Fixed(Nothing(), Exactly((place, f"{name}-far")), Whole(1, total))

    def agrees(found: tuple[CoarseLattice, Samples, int]) -> bool:
        lattice, samples, patches = found
        sampled = samples.sums[:, 0]
        # (c,): samples lie in just those coarse cells that the lattice has.
        parents = unique_keys(ancestor_keys(samples.cells, plan.coarse - plan.far))
        return (
            np.array_equal(parents, lattice.cells)
            and float(sampled.sum()) == float(lattice.moments[:, 0].sum())
            and _lie_below(np.abs(samples.sums[:, 1:4]), 0.5 * _ROUNDED * sampled)
            and _lie_below(np.abs(samples.sums[:, 4:]), _ROUNDED * sampled)
            and len(samples.cells) <= patches
        )

    cells = cells_in(plan.grid.box, plan.origin, plan.cell_size * 2.0**plan.far)
    samples = pattern_of(Samples, cells=cells)
    pattern = Fixed(coarse_lattice(plan, own), samples, Whole(1, total))
    return Where(pattern, agrees, "cells have the sums of the tile's points")


def coarse_lattice(plan: TilePlan, own: tuple[IntArray, IntArray] | None) -> Declared:
    """Return the pattern of the lattice that a tile adds to; `own` is as of `tasks.sum_tile`."""
    box, size = plan.grid.box, plan.coarse_size

    def agrees(lattice: CoarseLattice) -> bool:
        counts, corners = lattice.moments[:, 0], lattice.vertices
        # The corners of the cells are there, and none but theirs and their neighbours'.
        inner, outer = (kernels.spread_keys(lattice.cells, *far) for far in ((0, 1), (-1, 2)))
        return (
            (own is None or all(map(np.array_equal, own, (lattice.cells, counts))))
            and _lie_below(np.abs(lattice.moments), _LARGEST_MOMENT * counts)
            and bool((lattice.squares >= counts).all())
            and bool((lattice.squares <= counts * counts).all())
            and bool((find_keys(corners, inner) < len(corners)).all())
            and bool((find_keys(outer, corners) < len(outer)).all())
        )

    lattice = pattern_of(
        CoarseLattice,
        cells=cells_in(box, plan.origin, size),
        vertices=cells_in(box, plan.origin, size, 3),
    )
    return Where(lattice, agrees, "moments are of the points that its cells hold")


def summed_bytes(
    _plan: TilePlan, points: Any, _ticket: Any = None, keep: tuple[str, str] | None = None, *_: Any
) -> int:
    """Return how large what `tasks.sum_tile` returns may be, in bytes."""
    return SMALL_BYTES + (0 if keep is not None else _SUMMED_POINT * int(estimate_work(points)))


def _lie_below(rows: FloatArray, most: FloatArray) -> bool:
    return bool((rows <= most[:, None]).all())


def surface_bytes(
    plan: TilePlan, coarse: CoarseLevels, keep: tuple[str, str] | None, spans_gaps: bool = False
) -> int:
    """Return how large what a tile's surface comes to may be, in bytes.

    The master knows the coarse corners around the tile, which lie along the surface; in each coarse
    cell there may be a sheet for every other finest one. What spans gaps may be as large as the
    grid's sides besides.
    """
    # In a coarse cell, half as many as it has layers of finest ones.
    sheets = 2.0 ** (plan.coarse - 1)
    squares = sheets * len(coarse.parents.keys) * (plan.coarse_size / plan.step) ** 2
    if spans_gaps:
        x, y, z = plan.bricks
        squares += 2 * BRICK**2 * (x * y + y * z + z * x)
    return SMALL_BYTES + int(squares) * (_SENT_SQUARE if keep is None else _KEPT_SQUARE)


def tile_surface(plan: TilePlan, keep: tuple[str, str] | None) -> Declared:
    """Return the pattern of what `tasks.mesh_tile` returns, or keeps by a store and a name."""
    first = np.zeros(3, np.int64)
    last = np.array(plan.bricks) - 1
    bricks = keys_within(first, last)
    most = MOST_VERTICES, MOST_FACES
    return part_surface(bricks, bricks.of(Exits), surface_box(plan), most, keep)


def kept_part(summary: PartSummary) -> Declared:
    """Return the pattern of a part that a worker has kept, and told this summary of."""
    told = {name: getattr(summary, name) for name in _TOLD}
    sizes = {"b": len(summary.bricks), "g": len(summary.foreign_bricks)}
    part = pattern_of(MeshPart, sizes, **{name: Bounds(of, of) for name, of in told.items()})
    return Where(part, _is_part, _PART_RULE)


def part_surface(
    bricks: Bounds,
    exits: Declared,
    box: Box,
    most: tuple[int, int],
    keep: tuple[str, str] | None,
) -> Declared:
    """Return the pattern of a part, its summary and its exits.

    `most` tells how many vertices and faces a brick has at most.
    """
    low, high = box
    of_bricks = {
        "bricks": bricks,
        "vertex_counts": Bounds(high=most[0]),
        "face_counts": Bounds(high=most[1]),
        "foreign_numbers": Bounds(high=most[0] - 1),
    }
    part = pattern_of(MeshPart, **of_bricks, vertices=Bounds(low, high))
    summary = pattern_of(PartSummary, **of_bricks, rim_places=Bounds(low, high))
    named = "what it names lies among its bricks, vertices, faces and components"
    return Fixed(
        Where(part, _is_part, _PART_RULE) if keep is None else Nothing(),
        Where(summary, lambda found: _is_summary(found, box), named),
        exits,
    )


def _is_part(part: MeshPart) -> bool:
    return (
        int(part.vertex_counts.sum(dtype=np.int64)) == len(part.vertices)
        and int(part.face_counts.sum(dtype=np.int64)) == len(part.faces)
        and lie_within(part.faces, -len(part.foreign_bricks), len(part.vertices))
        and rise_by_pairs(part.foreign_bricks, part.foreign_numbers)
    )


def _is_summary(part: PartSummary, box: Box) -> bool:
    own, components = int(part.vertex_counts.sum(dtype=np.int64)), len(part.bounds)
    faces, pieces = int(part.face_counts.sum(dtype=np.int64)), len(part.piece_vertices)
    labels = part.foreign_labels, part.entry_labels, part.mixed_labels
    vertices = part.piece_vertices, part.bare, part.seam_faces[:, 1:], part.rim
    return (
        _are_entries(part)
        and all(lie_within(of, 0, components) for of in labels)
        and all(lie_within(of, -len(part.foreign_bricks), own) for of in vertices)
        and lie_within(part.piece_units, -1, len(part.bricks))
        and lie_within(part.sides[:, 0], 0, 3 * faces)
        and lie_within(part.sides[:, 1:], 0, pieces)
        and lie_within(part.seam_faces[:, 0], 0, faces)
        and rise_by_pairs(part.foreign_bricks, part.foreign_numbers)
        and are_bounds(part.bounds, box)
    )


def _are_entries(part: PartSummary) -> bool:
    """Tell whether the entries of each brick add up to what it counts."""
    starts, own = part.entry_starts, part.entry_vertices
    if not (starts[0] == 0 and starts[-1] == len(own) and (starts[1:] >= starts[:-1]).all()):
        return False
    # (b,) each: sums over the entries of each brick, and how many of them have vertices.
    vertices, faces, kinds = (
        np.diff(starts_of(values)[starts]) for values in (own, part.entry_faces, own > 0)
    )
    return (
        np.array_equal(vertices, part.vertex_counts)
        and np.array_equal(faces, part.face_counts)
        and bool((part.entry_supports <= own).all())
        and int(part.vertex_counts[kinds > 1].sum(dtype=np.int64)) == len(part.mixed_labels)
    )


def are_bounds(bounds: FloatArray, box: Box) -> bool:
    """Tell whether boxes lie in another one; those around nothing are inside out."""
    low, high = bounds[:, :3], bounds[:, 3:]
    is_empty = (low == np.inf).all(axis=1) & (high == -np.inf).all(axis=1)
    is_inside = (low >= box[0]).all(axis=1) & (low <= high).all(axis=1)
    return bool((is_empty | (is_inside & (high <= box[1]).all(axis=1))).all())
