"""Marching cubes over bricks, welded by edge numbers and never by coordinates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcapp.geometry.lattice import OCTANTS, find_keys, pack_places, step_keys
from hpcapp.geometry.points import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
)
from hpcapp.kernels.case_table import EDGES, case_triangles, triangle_counts
from hpcapp.kernels.portable.field.strides import ENDS, line_shifts
from hpcapp.kernels.portable.surface.transitions import (
    find_transitions,
    trace_loops,
    triangulate_loop,
)
from hpcapp.kernels.types.brick_mesh import BrickMesh
from hpcapp.kernels.types.grid import BRICK, Grid

_NEAREST = 0.002
"""Vertices keep this share of an edge from its ends, so that no triangle has zero area."""


def extract_surface(
    grid: Grid, places: IntArray, values: Float32Array, taken: BoolArray | None = None
) -> BrickMesh:
    """Extract the 0-level of the node values: manifold, and closed where all bricks are there.

    Places (b, 3) are sorted, as `grow_bricks` gives them; values (b, 9, 9, 9) are negative inside,
    never 0. `taken` (b,) is False for bricks whose neighbours may be missing: their faces are left
    out there. Raise `ValueError` where a brick that the surface enters from one that is taken is
    missing. The mesh is edge- and vertex-manifold; the vertex on an edge belongs to the brick of
    the edge's lower node.
    """
    taken = np.ones(len(places), np.bool_) if taken is None else taken
    inside = values < 0.0
    shifts = None if grid.strides is None else line_shifts(grid, places)
    crossed, lengths = _find_crossed(inside, shifts)
    # Vertices are numbered in that order; edges that are not crossed hold the one before.
    numbers = (np.cumsum(crossed.reshape(-1)) - 1).astype(np.int32).reshape(crossed.shape)
    vertices = _place_vertices(grid, places, values, crossed, lengths)
    on_edges = _EdgeNumbers(places, numbers)
    faces, owner = _assemble_faces(inside, shifts, on_edges)
    if shifts is not None:
        pieces = [(faces, owner), *_assemble_transitions(inside, shifts, on_edges, vertices)]
        faces, owner = (np.concatenate(of) for of in zip(*pieces, strict=True))
        order = np.argsort(owner, kind="stable")
        faces, owner = faces[order], owner[order]
    whole = np.logical_and.reduce(faces >= 0, axis=1)
    if not (whole | ~taken[owner]).all():
        raise ValueError("places: a brick that the surface enters is missing")
    return BrickMesh(
        pack_places(places),
        taken,
        crossed.sum(axis=(1, 2, 3, 4)).astype(np.int32),
        np.bincount(owner[whole], minlength=len(places)).astype(np.int32),
        vertices,
        faces[whole],
        np.empty(0, np.int64),
    )


def _find_crossed(inside: BoolArray, shifts: ByteArray | None) -> tuple[BoolArray, IntArray | None]:
    """Tell whether the edge from each node along each axis is crossed, shape (b, 3, 8, 8, 8).

    And how long these edges are, in finest steps, where they are not all 1.
    """
    lower = (slice(None), *[slice(0, BRICK)] * 3)
    crossed = np.empty((len(inside), 3, BRICK, BRICK, BRICK), np.bool_)
    if shifts is None:
        for axis in range(3):
            np.not_equal(inside[lower], inside[_shifted(axis)], out=crossed[:, axis])
        return crossed, None
    lengths = np.empty(crossed.shape, np.int64)
    node = np.indices((BRICK,) * 3)  # (3, 8, 8, 8)
    brick = np.arange(len(inside))[:, None, None, None]
    for axis in range(3):
        ends = [ENDS[:BRICK]] * 3
        ends[axis] = np.ones(BRICK, np.int64)
        x, y, z = np.ix_(*ends)
        length = lengths[:, axis] = 1 << shifts[:, x, y, z].astype(np.int64)
        upper = [np.minimum(at + length * (a == axis), BRICK) for a, at in enumerate(node)]
        is_node = ((node[0] | node[1] | node[2]) & (length - 1)) == 0
        crossed[:, axis] = is_node & (inside[lower] != inside[brick, *upper])
    return crossed, lengths


def _place_vertices(
    grid: Grid,
    places: IntArray,
    values: Float32Array,
    crossed: BoolArray,
    lengths: IntArray | None,
) -> FloatArray:
    """Place a vertex on each crossed edge."""
    brick, axis_of, *node = np.nonzero(crossed)
    local = np.stack(node, axis=1)  # (v, 3): the lower node of each crossed edge, in its brick
    length = np.ones(len(brick), np.int64) if lengths is None else lengths[crossed]
    coordinates = (BRICK * places[brick] + local).astype(np.float64)
    shares = _cross_edges(values, brick, local, axis_of, length)
    coordinates[np.arange(len(brick)), axis_of] += length * shares
    return grid.origin + coordinates * grid.step


def _cross_edges(
    values: Float32Array, brick: IntArray, local: IntArray, axis: IntArray, length: IntArray
) -> FloatArray:
    """Return how far along each edge the surface crosses it, by a parabola through its ends.

    A distance bends along an edge wherever the surface is curved: straight lines would put all
    vertices on its hollow side. The parabola bends like the smaller of the two second differences
    of the four nodes next to the edge in its brick, and not at all where they disagree, as they
    do at creases and at the rims of the quadrics; it is monotone. On lines with fewer nodes in the
    brick it is straight.
    """
    rows = np.arange(len(local))
    place, last = local[rows, axis] // length, BRICK // length
    nodes = local.copy()

    def at(along: IntArray) -> FloatArray:
        nodes[rows, axis] = length * np.minimum(along, last)
        x, y, z = nodes.T
        value: FloatArray = values[brick, x, y, z].astype(np.float64)
        return value

    # Four nodes in a row around the edge, as far as the brick has them: (3, v) rises between
    # them, and two second differences.
    start = np.maximum(np.minimum(place - 1, last - 3), 0)
    rises = np.diff([at(start + i) for i in range(4)], axis=0)
    lower, upper = np.diff(rises, axis=0)
    first = at(place)
    rise = at(place + 1) - first
    smaller = np.where(np.abs(lower) < np.abs(upper), lower, upper)
    most = np.abs(rise)
    bends = (lower * upper > 0.0) & (last >= 3)
    bend = np.where(bends, 0.5 * np.clip(smaller, -most, most), 0.0)
    # first + slope t + bend t^2 = 0, by the root that loses no digits where bend is small.
    slope = rise - bend
    root = np.sqrt(slope * slope - 4.0 * bend * first)
    share: FloatArray = 2.0 * np.abs(first) / (root + np.abs(slope))
    return share.clip(_NEAREST, 1.0 - _NEAREST)


def _shifted(axis: int) -> tuple[slice, ...]:
    """Return the index of the nodes one step up along an axis from the lower 8^3."""
    return (slice(None), *[slice(1, BRICK + 1) if a == axis else slice(0, BRICK) for a in range(3)])


class _EdgeNumbers:
    """Looks up the vertices on edges of bricks (b, 3).

    `numbers` (b, 3, 8, 8, 8) are those of the vertices, by axis and lower node.
    """

    def __init__(self, places: IntArray, numbers: Int32Array) -> None:
        keys = pack_places(places)
        self._numbers, self._missing = numbers, len(keys)
        # (b, 8): the rows of the bricks that own edges of a brick's cells: itself, and those above.
        self._owners = np.stack([find_keys(keys, step_keys(keys, o)) for o in OCTANTS], axis=1)

    def at(self, brick: IntArray, axis: IntArray | int, node: IntArray) -> Int32Array:
        """Return the vertices (m,) on some edges, -1 for those of a brick that is not there.

        `node` (m, 3) is the lower one, in the brick; the edge belongs to the brick of this node,
        which may be the next one. Edges that are not crossed get numbers without a meaning; no
        triangle asks for them.
        """
        over = node == BRICK
        owner = self._owners[brick, over @ np.array([1, 2, 4])]
        x, y, z = np.where(over, 0, node).T
        number = self._numbers[np.where(owner == self._missing, 0, owner), axis, x, y, z]
        return np.where(owner == self._missing, np.int32(-1), number)


def _assemble_faces(
    inside: BoolArray, shifts: ByteArray | None, on_edges: _EdgeNumbers
) -> tuple[IntArray, IntArray]:
    """Look up the triangles, and their bricks, of all crossed cells that have no finer nodes."""
    brick, cell, size, case = _find_cells(inside, shifts)
    vertex_of_edge = np.empty((len(brick), len(EDGES)), np.int32)
    for edge, (axis, corner) in enumerate(EDGES):
        vertex_of_edge[:, edge] = on_edges.at(brick, axis, cell + size * OCTANTS[corner])
    counts = triangle_counts()[case]
    # (f,): the cell of each triangle, and which of that cell's triangles it is.
    owner = np.repeat(np.arange(len(case)), counts)
    first = np.cumsum(counts) - counts
    turn = np.arange(len(owner)) - first[owner]
    edges = case_triangles()[case[owner], turn]
    return vertex_of_edge[owner[:, None], edges].astype(np.int64), brick[owner]


def _find_cells(
    inside: BoolArray, shifts: ByteArray | None
) -> tuple[IntArray, IntArray, IntArray, ByteArray]:
    """Return the brick, the lowest node, the size and the case of the cells that are crossed."""
    bricks = np.arange(len(inside))
    exponents = np.zeros(1, np.uint8) if shifts is None else np.unique(shifts[:, 1, 1, 1])
    found = []
    for exponent in exponents.tolist():
        rows = bricks if shifts is None else bricks[shifts[:, 1, 1, 1] == exponent]
        size, count = 1 << exponent, BRICK >> exponent
        # (b, c, c, c): bit c is set where corner c of the cell is inside.
        cases = np.zeros((len(rows), *[count] * 3), np.uint8)
        for corner, octant in enumerate(OCTANTS):
            index = [slice(int(o) * size, int(o) * size + BRICK, size) for o in octant]
            cases |= inside[rows][:, *index].astype(np.uint8) << np.uint8(corner)
        crossed = (cases != 0) & (cases != 255)
        if exponent:
            assert shifts is not None  # noqa: S101 - or all strides are 1
            crossed &= ~find_transitions(shifts[rows], exponent)
        brick, *cell = np.nonzero(crossed)
        sizes = np.full((len(brick), 1), size)
        found.append((rows[brick], size * np.stack(cell, axis=1), sizes, cases[brick, *cell]))
    brick, node, size, case = (np.concatenate(of) for of in zip(*found, strict=True))
    return brick, node, size, case


def _assemble_transitions(
    inside: BoolArray, shifts: ByteArray, on_edges: _EdgeNumbers, vertices: FloatArray
) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield the triangles of each loop on a cell that has finer nodes, and their brick."""
    for brick in np.flatnonzero((shifts < shifts[:, 1:2, 1:2, 1:2]).any(axis=(1, 2, 3))):
        exponent = int(shifts[brick, 1, 1, 1])
        size = 1 << exponent
        for cell in size * np.argwhere(find_transitions(shifts[[brick]], exponent)[0]):
            for loop in trace_loops(inside[brick], shifts[brick], cell, size):
                rows = np.full(len(loop.edges), brick)
                corners = on_edges.at(rows, loop.edges[:, 0], loop.edges[:, 1:])
                faces = np.full((len(rows) - 2, 3), -1)
                if (corners >= 0).all():
                    faces[:] = corners[np.array(triangulate_loop(loop, vertices[corners]))]
                yield faces, rows[2:]
