"""Faces of the cells at which bricks of different strides meet.

Such a cell has finer nodes on some of its faces or edges. Each of its faces is cut into quads as
the finer bricks beside it have them, and on the border of each quad every run of inside nodes is
cut off by a segment of its own, as in `case_table`: so both cells at a quad agree on its segments.
These close to loops, and the loops become triangles, without a vertex of their own.

No diagonal may be an edge that another cell makes too. Those within a quad are two cells' to make:
each makes none but those between vertices at which it leaves the inside, as it goes round the quad,
which are the others to the cell behind. So do, of two vertices on one edge of a cell, the cell and
the one across that edge: one has those where the edge leaves the inside, upwards, one the others.

References
----------
M. Kazhdan, A. Klein, K. Dalal, H. Hoppe, Unconstrained isosurface extraction on arbitrary octrees,
SGP 2007, doi:10.2312/SGP/SGP07/125-133.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray, IntArray
from hpcapp.kernels.portable.field.strides import ENDS
from hpcapp.kernels.types.grid import BRICK
from hpccomponent.dataclass import dataclass

_Node = tuple[int, int, int]
_Edge = tuple[int, _Node]  # along an axis, from its lower node


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """A closed line on the faces of a cell, of n vertices.

    `edges` (n, 4) are the axis and the lower node, in its brick, of the edge that each vertex lies
    on; `quads` (n,) the quad that the line crosses from each to the next; `sides` (n,) the edge of
    the cell that each lies on, different negative numbers where none. Where it is `owned` (n,),
    diagonals along that edge to others of these are the cell's to make.
    """

    edges: IntArray
    quads: IntArray
    sides: IntArray
    owned: BoolArray


def find_transitions(shifts: ByteArray, exponent: int) -> BoolArray:
    """Tell which cells of some bricks have finer nodes on a face or on an edge, (b, c, c, c).

    `shifts` (b, 3, 3, 3) are those of `strides.line_shifts`; all these bricks have one stride.
    """
    count = BRICK >> exponent
    # (3, c): whether the cells, by their place along an axis, touch its ends, or what is between.
    touches = np.ones((3, count), np.bool_)
    touches[0, 1:] = touches[2, :-1] = False
    found = np.zeros((len(shifts), count, count, count), np.bool_)
    for x, y, z in np.ndindex(3, 3, 3):
        touched = touches[x][:, None, None] & touches[y][:, None] & touches[z]
        found |= touched & (shifts[:, x, y, z] < exponent)[:, None, None, None]
    return found


def trace_loops(inside: BoolArray, shifts: ByteArray, cell: IntArray, size: int) -> list[Loop]:
    """Find the loops in which the surface crosses the faces of a cell, of three vertices or more.

    `inside` (9, 9, 9) and `shifts` (3, 3, 3) are of the brick, `cell` (3,) is the cell's lowest
    node in it. A loop of two lies on an edge of the cell, and has no faces: what it joins are the
    two cells beside it.
    """
    low = tuple(cell.tolist())
    following: dict[_Edge, _Edge] = {}
    quads: dict[_Edge, int] = {}
    for quad, corners in enumerate(_cut_faces(shifts, low, size)):
        # The surface crosses the border of a quad between nodes on different sides of it.
        nodes = _walk_around(shifts, corners)
        crossings = [
            (_edge_between(one, other), bool(inside[other]))
            for one, other in zip(nodes, [*nodes[1:], nodes[0]], strict=True)
            if inside[one] != inside[other]
        ]
        for number, (edge, enters) in enumerate(crossings):
            if not enters:  # where the run of inside nodes ends that the one before begins
                following[edge], quads[edge] = crossings[number - 1][0], quad
    loops = []
    while following:
        loop = [next(iter(following))]
        while (edge := following.pop(loop[-1])) != loop[0]:
            loop.append(edge)
        if len(loop) > 2:
            loops.append(
                Loop(
                    np.array([(axis, *node) for axis, node in loop]),
                    np.array([quads[edge] for edge in loop]),
                    np.array([_side_of(edge, low, size, -1 - n) for n, edge in enumerate(loop)]),
                    np.array([bool(inside[edge[1]]) == _lies_below(edge, low) for edge in loop]),
                )
            )
    return loops


def _shift_at(shifts: ByteArray, node: _Node, *along: int) -> int:
    """Return the shift of a line through a node along an axis, or of a face along two."""
    ends = [1 if axis in along else int(ENDS[node[axis]]) for axis in range(3)]
    return int(shifts[ends[0], ends[1], ends[2]])


def _moved(node: _Node, axis: int, step: int) -> _Node:
    x, y, z = (at + step * (a == axis) for a, at in enumerate(node))
    return x, y, z


def _cut_faces(shifts: ByteArray, low: _Node, size: int) -> Iterator[list[_Node]]:
    """Yield the corners of the quads on a cell's faces, anticlockwise as seen from outside."""
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, size):
            corner = _moved(low, axis, end)
            step = 1 << _shift_at(shifts, corner, b, c)
            for at_b in range(0, size, step):
                for at_c in range(0, size, step):
                    first = _moved(_moved(corner, b, at_b), c, at_c)
                    ahead, beside = (b, c) if end else (c, b)
                    second = _moved(first, ahead, step)
                    yield [first, second, _moved(second, beside, step), _moved(first, beside, step)]


def _walk_around(shifts: ByteArray, corners: list[_Node]) -> list[_Node]:
    """Return all nodes on the border of a quad, from corner to corner."""
    nodes = []
    for node, corner in zip(corners, [*corners[1:], corners[0]], strict=True):
        axis = next(a for a in range(3) if node[a] != corner[a])
        step = 1 << _shift_at(shifts, node, axis)
        step = step if corner[axis] > node[axis] else -step
        nodes += [_moved(node, axis, at) for at in range(0, corner[axis] - node[axis], step)]
    return nodes


def _edge_between(one: _Node, other: _Node) -> _Edge:
    return next(axis for axis in range(3) if one[axis] != other[axis]), min(one, other)


def _side_of(edge: _Edge, low: _Node, size: int, none: int) -> int:
    """Return the number of the cell's edge that an edge is on, `none` where it is on none."""
    axis, node = edge
    number = axis
    for other in range(3):
        if other != axis:
            if node[other] not in (low[other], low[other] + size):
                return none
            number = 2 * number + (node[other] > low[other])
    return number


def _lies_below(edge: _Edge, low: _Node) -> bool:
    """Tell whether a cell lies below the edge of it that an edge is on, along the next axis."""
    axis, node = edge
    return node[(axis + 1) % 3] > low[(axis + 1) % 3]


def triangulate_loop(loop: Loop, places: FloatArray) -> list[tuple[int, int, int]]:
    """Cut a loop into n - 2 triangles, anticlockwise as seen from outside: rows of `places` (n, 3).

    As few as may be look against the loop as a whole; of such triangulations, the one with the
    least sum of squared diagonals. It takes time with the cube of n.
    """
    count = len(places)
    lengths, turns = _measure_pairs(places)
    weights = np.where(_may_join(loop), lengths, np.inf)
    weights[0, -1] = 0.0  # which is no diagonal
    penalty = count * lengths.max()
    # (n, n): the least cost of what lies between two vertices, and the third vertex there.
    costs, apexes = np.full((count, count), np.inf), np.zeros((count, count), np.int64)
    costs[np.arange(count - 1), np.arange(1, count)] = 0.0
    for width in range(2, count):
        for i in range(count - width):
            j = i + width
            between = slice(i + 1, j)
            totals = costs[i, between] + costs[between, j]
            is_turned = turns[i, between] + turns[between, j] + turns[j, i] <= 0.0
            totals += np.where(is_turned, penalty, 0.0)
            best = int(totals.argmin())
            costs[i, j], apexes[i, j] = totals[best] + weights[i, j], i + 1 + best
    if not np.isfinite(costs[0, -1]):
        raise ValueError("places: a loop has no triangles that are its own")
    return list(_list_triangles(apexes, 0, count - 1))


def _measure_pairs(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the squared distances between vertices, and their cross products' shares in the loop.

    The latter, summed over the sides of a triangle, tell whether it looks as the loop does.
    """
    x, y, z = (places - places[0]).T
    dx, dy, dz = (axis[:, None] - axis for axis in (x, y, z))
    crosses = [a[:, None] * b - b[:, None] * a for a, b in ((y, z), (z, x), (x, y))]
    # Twice the area of the loop as a vector: the sum of the cross products along its sides.
    normal = [0.0, 0.0, 0.0]
    for i in range(len(places)):
        j = (i + 1) % len(places)
        normal = [total + float(cross[i, j]) for total, cross in zip(normal, crosses, strict=True)]
    turns = normal[0] * crosses[0] + normal[1] * crosses[1] + normal[2] * crosses[2]
    return dx * dx + dy * dy + dz * dz, turns


def _may_join(loop: Loop) -> BoolArray:
    """Tell which pairs of vertices a diagonal may join, shape (n, n)."""
    after, before = loop.quads, np.roll(loop.quads, 1)
    joined: BoolArray = before[:, None] != before
    joined &= (before[:, None] != after) & (after[:, None] != before)
    is_owned = (after[:, None] == after) | (loop.owned[:, None] & loop.owned)
    joined &= (loop.sides[:, None] != loop.sides) | is_owned
    return joined


def _list_triangles(apexes: IntArray, i: int, j: int) -> Iterator[tuple[int, int, int]]:
    """Yield the triangles between two vertices of a loop."""
    if j - i > 1:
        apex = int(apexes[i, j])
        yield from _list_triangles(apexes, i, apex)
        yield i, j, apex
        yield from _list_triangles(apexes, apex, j)
