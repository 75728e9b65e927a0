"""Vertices on the edges of a surface, where marching cubes has cut these off.

A face with its corners on two smooth pieces cuts the edge between them off: small teeth along it.
Of each mesh edge from one piece to another, one end is moved to where the pieces meet; then no
face is left on both. Vertices keep their ids, and so seams hold.

References
----------
L. P. Kobbelt, M. Botsch, U. Schwanecke, H.-P. Seidel, Feature sensitive surface extraction from
volume data, SIGGRAPH 2001, doi:10.1145/383259.383265.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.lattice import find_keys, pack_places
from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray, IntArray
from hpcapp.kernels import spread_keys
from hpcapp.kernels.types.field import Features
from hpccomponent.cutting import cut_equal
from hpccomponent.dataclass import dataclass

_NEAR = 0.3  # cells: pieces that are farther from a vertex are not the surface there
_FARTHEST = 1.5  # grid steps that a vertex may be moved
_LEAST_SINE = 0.4  # of the angle of two pieces where they meet
_NEWTON = 3  # steps to where they meet
_AT_ONCE = 1 << 17  # faces
_ONE_EDGE = 0.8  # cos of the angle of two tangents that may be one edge's
_LEAST_AREA = 0.001  # squared grid steps, of a face with a moved vertex


@dataclass(frozen=True, slots=True, eq=False)
class _Crossings:
    """Mesh edges from one smooth piece to another; m of them."""

    ends: IntArray  # (m, 2), vertices
    meetings: FloatArray  # (m, 3), where the pieces meet, in cells
    tangents: FloatArray  # (m, 3), unit length, along the edge of the surface
    distances: FloatArray  # (m, 2), of the ends from there, in cells
    normals: FloatArray  # (m, 2, 3), of the piece that each end lies on, of any length

    def take(self, rows: BoolArray) -> _Crossings:
        return _Crossings(
            self.ends[rows],
            self.meetings[rows],
            self.tangents[rows],
            self.distances[rows],
            self.normals[rows],
        )

    def nearer(self) -> IntArray:
        """Return which end, 0 or 1, is the nearer one."""
        return np.where(self.distances[:, 0] <= self.distances[:, 1], 0, 1)


def sharpen_vertices(
    vertices: FloatArray,
    faces: IntArray,
    balanced: FloatArray,
    features: Features,
    lattice: tuple[FloatArray, float],
    steps: FloatArray,
) -> FloatArray:
    """Move vertices beside the edges of a surface onto these.

    Vertices (v, 3) are where marching cubes has put them, `balanced` (v, 3) where
    `kernels.balance_vertices` has: it takes edges for round. Faces (f, 3) are anticlockwise as seen
    from outside. `lattice` is where vertex (0, 0, 0) of the features' lattice lies, and the edge of
    its cells, `steps` (v,) those of the grid around each vertex; all in length units of the input.

    Returns (v, 3): on edges; in the faces beside them as marching cubes has it; balanced elsewhere.
    A vertex that would turn a face over, or leave it no area, stays. What a vertex gets depends on
    nothing farther away than seven faces.
    """
    if not len(features.keys):
        return balanced
    origin, cell_size = lattice
    places = (vertices - origin) / cell_size  # (v, 3): in cells
    farthest = _FARTHEST * steps / cell_size  # (v,)
    faces = faces[_mark_near(places, steps / cell_size, features)[faces].any(axis=1)]
    if not len(faces):
        return balanced
    pieces = cut_equal(len(faces), -(-len(faces) // _AT_ONCE))
    crossings = _join([_find_crossings(places, faces[piece], features) for piece in pieces])
    is_near = crossings.distances <= farthest[crossings.ends]
    crossings = crossings.take(np.logical_or.reduce(is_near, axis=1))
    if not len(crossings.ends):
        return balanced
    # (k,) and (k, 3): the vertices that move, and where to.
    rows, goals = _find_goals(crossings, _choose_ends(crossings, len(vertices)))
    is_near = ((goals - places[rows]) ** 2).sum(axis=1) <= farthest[rows] * farthest[rows]
    rows, goals = rows[is_near], origin + cell_size * goals[is_near]
    is_moved = np.zeros(len(vertices), np.bool_)
    is_moved[rows] = True
    # Beside an edge vertices are where marching cubes has put them, elsewhere balanced.
    around = faces[is_moved[faces].any(axis=1)]
    before, moved = balanced.copy(), balanced.copy()
    before[around] = moved[around] = vertices[around]
    moved[rows] = goals
    normals = _find_normals(crossings, is_moved, before, around)
    shortest = steps[around].min(axis=1)
    return _hold_faces(before, moved, around, normals, _LEAST_AREA * shortest * shortest)


def _mark_near(places: FloatArray, steps: FloatArray, features: Features) -> BoolArray:
    """Mark the vertices whose mesh edges may have their middle next to a feature, and some more.

    `places` and `steps` are in cells. An edge is no longer than two steps along each axis: below
    two cells, its middle is rounded to one of the 27 lattice vertices around each of its ends.
    """
    around = spread_keys(features.keys, -1, 1)
    keys = pack_places(np.rint(places).astype(np.int64))
    is_near: BoolArray = find_keys(around, keys) < len(around)
    return is_near | (steps >= 1.0)


def _join(parts: list[_Crossings]) -> _Crossings:
    return _Crossings(
        np.concatenate([part.ends for part in parts]),
        np.concatenate([part.meetings for part in parts]),
        np.concatenate([part.tangents for part in parts]),
        np.concatenate([part.distances for part in parts]),
        np.concatenate([part.normals for part in parts]),
    )


def _find_crossings(places: FloatArray, faces: IntArray, features: Features) -> _Crossings:
    """Return the mesh edges from one piece to another, as the nearest lattice vertex has them.

    `places` are those of the vertices, in cells.
    """
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = ends[ends[:, 0] < ends[:, 1]]  # each is there once in either direction
    # (m, 3): the lattice vertex next to each mesh edge's middle; only those with pieces matter.
    centre = np.rint(0.5 * (places[ends[:, 0]] + places[ends[:, 1]]))
    feature = find_keys(features.keys, pack_places(centre.astype(np.int64)))
    has_pieces = feature < len(features.keys)
    ends, centre, feature = ends[has_pieces], centre[has_pieces], feature[has_pieces]
    pieces, joints = features.pieces[feature].astype(np.float64), features.joints[feature]
    start, end = places[ends[:, 0]] - centre, places[ends[:, 1]] - centre
    # (m, 3): the pieces at both ends, and which of them is the surface there.
    at_start, at_end = _evaluate(pieces, start), _evaluate(pieces, end)
    one, other = _find_active(at_start, pieces, joints), _find_active(at_end, pieces, joints)
    rows = np.arange(len(ends))
    off = np.maximum(np.abs(at_start[rows, one]), np.abs(at_end[rows, other]))
    rows = np.flatnonzero((one != other) & (off < _NEAR))
    one, other = one[rows], other[rows]
    # Where along the mesh edge both pieces are equal: from there to where both are 0.
    before = at_start[rows, one] - at_start[rows, other]
    after = at_end[rows, one] - at_end[rows, other]
    share = np.clip(before / np.where(before == after, 1.0, before - after), 0.0, 1.0)
    at = start[rows] + share[:, None] * (end[rows] - start[rows])
    first, second = pieces[rows, one], pieces[rows, other]
    at, tangents, good = _meet(first, second, at)
    ends, meetings = ends[rows], centre[rows] + at
    distances = np.sqrt(((meetings[:, None] - places[ends]) ** 2).sum(axis=2))
    normals = [_differentiate(first, start[rows]), _differentiate(second, end[rows])]
    return _Crossings(ends, meetings, tangents, distances, np.stack(normals, axis=1)).take(good)


def _evaluate(quadrics: FloatArray, at: FloatArray) -> FloatArray:
    """Evaluate quadrics, (m, k, 10) or (m, 10), at one place each."""
    x, y, z = at.T if quadrics.ndim == 2 else at.T[:, :, None]
    c = np.moveaxis(quadrics, -1, 0)
    value: FloatArray = c[0] + x * (c[1] + c[4] * x + c[7] * y)
    value += y * (c[2] + c[5] * y + c[8] * z)
    value += z * (c[3] + c[6] * z + c[9] * x)
    return value


def _differentiate(quadrics: FloatArray, at: FloatArray) -> FloatArray:
    """Return the gradients of quadrics, (m, 10), at one place each."""
    (x, y, z), c = at.T, quadrics.T
    return np.stack(
        [
            c[1] + 2.0 * c[4] * x + c[7] * y + c[9] * z,
            c[2] + 2.0 * c[5] * y + c[7] * x + c[8] * z,
            c[3] + 2.0 * c[6] * z + c[8] * y + c[9] * x,
        ],
        axis=1,
    )


def _find_active(values: FloatArray, pieces: FloatArray, joints: ByteArray) -> IntArray:
    """Return which piece the joined function is (see `Features`); of two equal ones, the first."""
    second = np.where((values[:, 1] < values[:, 2]) == ((joints & 2) > 0), 1, 2)
    second[(pieces[:, 1] == pieces[:, 2]).all(axis=1)] = 1
    inner = values[np.arange(len(values)), second]
    return np.where((values[:, 0] < inner) == ((joints & 1) > 0), 0, second)


def _meet(
    first: FloatArray, second: FloatArray, at: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Go from some places to where both quadrics are 0, the shortest way.

    Returns the places (m, 3), tangents (m, 3) of unit length, and (m,) False where the quadrics do
    not cross.
    """
    good = np.ones(len(at), np.bool_)
    for _ in range(_NEWTON):
        # The least step s with a . s = -f and b . s = -g lies in the plane of both gradients.
        a, b = _differentiate(first, at), _differentiate(second, at)
        aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
        determinant = aa * bb - ab * ab
        good &= determinant > _LEAST_SINE**2 * aa * bb
        inverse = np.where(good, 1.0, 0.0) / np.where(good, determinant, 1.0)
        f, g = _evaluate(first, at), _evaluate(second, at)
        along_a, along_b = (bb * f - ab * g) * inverse, (aa * g - ab * f) * inverse
        at = at - along_a[:, None] * a - along_b[:, None] * b
    tangents = np.cross(a, b)
    tangents /= np.maximum(np.sqrt((tangents**2).sum(axis=1)), 1e-300)[:, None]
    return at, tangents, good


def _choose_ends(crossings: _Crossings, vertices: int) -> BoolArray:
    """Choose the vertices to be moved: one end of each crossing, both of as few as may be.

    First those that are the nearer end of all their crossings, then the nearer ends of what is
    left. Those that no crossing needs are let go: else all three vertices of a face might come to
    lie on one edge.
    """
    ends, nearer = crossings.ends, crossings.nearer()
    # (v,): chosen vertices, and those that are the farther end of some crossing.
    chosen, farther = np.zeros((2, vertices), np.bool_)
    rows = np.arange(len(ends))
    best = ends[rows, nearer]
    farther[ends[rows, 1 - nearer]] = True
    chosen[best[~farther[best]]] = True
    chosen[best[~chosen[ends].any(axis=1)]] = True
    # Spare are those whose crossings all have another chosen end; of two spare ones, one stays.
    spare = chosen.copy()
    spare[ends[chosen[ends] & ~chosen[ends[:, ::-1]]]] = False
    both = spare[ends].all(axis=1)
    spare[best[both]] = False
    return chosen & ~spare


def _find_goals(crossings: _Crossings, chosen: BoolArray) -> tuple[IntArray, FloatArray]:
    """Return the chosen vertices, and the mean of the meetings of each on the edge next to it."""
    ends, of = crossings.ends.reshape(-1), np.repeat(np.arange(len(crossings.ends)), 2)
    kept = chosen[ends]
    ends, of = ends[kept], of[kept]
    # By vertex, and the nearest meeting first: the others count if they lie on the same edge.
    order = np.lexsort((of, crossings.distances.reshape(-1)[kept], ends))
    ends, of = ends[order], of[order]
    rows, first, group = np.unique(ends, return_index=True, return_inverse=True)
    cosines = (crossings.tangents[of] * crossings.tangents[of[first]][group]).sum(axis=1)
    same = np.abs(cosines) > _ONE_EDGE
    of, group = of[same], group[same]
    counts = np.bincount(group, minlength=len(rows))
    sums = [np.bincount(group, axis[of], len(rows)) for axis in crossings.meetings.T]
    return rows, np.stack(sums, axis=1) / counts[:, None]


def _find_normals(
    crossings: _Crossings, is_moved: BoolArray, vertices: FloatArray, faces: IntArray
) -> FloatArray:
    """Return where some faces are to look: as the pieces do that the vertices which stay lie on.

    Without such a vertex a face looks to where it does.
    """
    at = np.zeros_like(vertices)
    rows, group = np.unique(crossings.ends.reshape(-1), return_inverse=True)
    of_ends = crossings.normals.reshape(-1, 3)
    at[rows] = np.stack([np.bincount(group, axis, len(rows)) for axis in of_ends.T], axis=1)
    at[is_moved] = 0.0
    normals = at[faces].sum(axis=1)
    return np.where((normals != 0.0).any(axis=1)[:, None], normals, cross_edges(vertices[faces]))


def _hold_faces(
    before: FloatArray,
    moved: FloatArray,
    faces: IntArray,
    normals: FloatArray,
    least_areas: FloatArray,
) -> FloatArray:
    """Put vertices back that turn faces away from their normals, or take their area.

    Of each such face the farthest one; then all of those that are still wrong.
    """
    for last in (False, True):
        after = cross_edges(moved[faces])
        wrong = (normals * after).sum(axis=1) <= 0.0
        wrong |= (after * after).sum(axis=1) < 4.0 * least_areas * least_areas
        shifts = ((moved - before) ** 2).sum(axis=1)[faces]  # (f, 3): of the corners, squared
        wrong = np.flatnonzero(wrong & (shifts > 0.0).any(axis=1))
        back = faces[wrong] if last else faces[wrong, shifts[wrong].argmax(axis=1)]
        moved[back] = before[back]
    return moved
