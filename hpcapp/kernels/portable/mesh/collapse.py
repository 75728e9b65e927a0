"""Fewer faces: edges collapse in the order of their errors, and what is manifold stays so.

What a collapse costs depends on those before it. So this is plain Python, with the sums of the
native kernel in their order: both give the same bits.
"""

from __future__ import annotations

from heapq import heappop, heappush
from math import isfinite, sqrt

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray

__all__ = ["collapse_edges"]

_SOFT = 1e-8
"""What holds a new vertex at the middle of its edge, as a share of what holds it at the planes."""
_LEAST_COSINE = 0.2
"""Of the angle by which a face turns at once: 78 degrees, the rule of fast-simplification."""
_BORDER = 2.0
"""Weight of a border, in squares on its edges: planes weigh twice the areas of their faces."""
_MOST_FACES = 256
"""Around a new vertex: bounds what a collapse costs."""
_TINY = 1e-100
"""Twice the area of a face, in squared edges, that has no normal."""

_Vector = tuple[float, float, float]
_Planes = tuple[float, float, float, float, float, float]  # xx, xy, xz, yy, yz, zz
_Quadric = tuple[_Planes, _Vector, float]  # d A d + 2 b d + c at the offset d
_Candidate = tuple[float, int, int, int]  # cost, lower and higher vertex, the sum of their stamps


def collapse_edges(
    vertices: FloatArray, faces: IntArray, goal: int, limit: float, keeps_border: bool
) -> tuple[FloatArray, IntArray, IntArray, int]:
    """Collapse edges, the one that errs least first, where the mesh stays manifold.

    Faces (f, 3) that are not manifold, or not finite, stay as they are. Return vertices (w, 3),
    faces (g, 3) in the order of the input, the vertex of the input that each vertex was, (w,), and
    how many tetrahedra are gone.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
        In units of an edge or so.
    goal : int
        Stop at so many faces.
    limit : float
        What the sum of the squared distances from the planes of the faces, and the vertices of
        borders, that a vertex stands for stays below; infinite to have planes weigh as their faces
        are large, and to have tetrahedra dropped that move less than the rest would.
    keeps_border : bool
        Whether the vertices of borders stay where they are, and not the shape of the borders alone,
        so that parts of a mesh that meet at these are manifold together, too.

    Notes
    -----
    An edge errs by the squared distances of its new vertex from the planes of all faces that its
    ends stand for [1]_, and of those around them now [2]_. It costs that times the root of their
    mean, so that little that is far off counts as well as much that is near.

    References
    ----------
    .. [1] M. Garland, P. S. Heckbert, Surface simplification using quadric error metrics,
       SIGGRAPH 1997, https://doi.org/10.1145/258734.258849
    .. [2] P. Lindstrom, G. Turk, Evaluation of memoryless simplification,
       IEEE Transactions on Visualization and Computer Graphics 5, 1999,
       https://doi.org/10.1109/2945.765999
    """
    mesh = _Mesh(vertices, faces, limit, keeps_border)
    mesh.simplify(goal)
    sources = [v for v, corners in enumerate(mesh.corners) if corners]
    row = np.full(len(vertices), -1, np.int64)
    row[sources] = np.arange(len(sources))
    rest = np.array([v for v in mesh.vertex if v >= 0], np.int64).reshape(-1, 3)
    places = np.array([mesh.place[v] for v in sources], np.float64).reshape(-1, 3)
    return places, row[rest], np.array(sources, np.int64), mesh.dropped


def _add(a: _Vector, b: _Vector) -> _Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _subtract(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _scale(s: float, a: _Vector) -> _Vector:
    return s * a[0], s * a[1], s * a[2]


def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _weigh(weight: float, n: _Vector) -> _Planes:
    """Return the squared distance from a plane through the origin."""
    x, y, z = _scale(weight, n)
    return x * n[0], x * n[1], x * n[2], y * n[1], y * n[2], z * n[2]


def _add_planes(a: _Planes, sign: float, b: _Planes) -> _Planes:
    xx, xy, xz, yy, yz, zz = b
    return (
        a[0] + sign * xx, a[1] + sign * xy, a[2] + sign * xz,
        a[3] + sign * yy, a[4] + sign * yz, a[5] + sign * zz,
    )  # fmt: skip


def _times(m: _Planes, d: _Vector) -> _Vector:
    xx, xy, xz, yy, yz, zz = m
    x, y, z = d
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


def _evaluate(q: _Quadric, d: _Vector) -> float:
    return _dot(d, _times(q[0], d)) + 2.0 * _dot(q[1], d) + q[2]


def _see_from(q: _Quadric, d: _Vector) -> _Quadric:
    return q[0], _add(q[1], _times(q[0], d)), _evaluate(q, d)


def _add_quadrics(a: _Quadric, b: _Quadric) -> _Quadric:
    return _add_planes(a[0], 1.0, b[0]), _add(a[1], b[1]), a[2] + b[2]


def _find_least(m: _Planes, slope: _Vector) -> _Vector:
    """Return where a quadric is least; the origin where its planes are not positive definite."""
    xx, xy, xz, yy, yz, zz = m
    if not xx > 0.0:
        return 0.0, 0.0, 0.0
    # Elimination without roots; where a pivot is not positive, there is no least place.
    left, down = xy / xx, xz / xx
    second, mixed = yy - left * xy, yz - left * xz
    if not second > 0.0:
        return 0.0, 0.0, 0.0
    turn = mixed / second
    third = zz - down * xz - turn * mixed
    if not third > 0.0:
        return 0.0, 0.0, 0.0
    v = left * slope[0] - slope[1]
    w = down * slope[0] - slope[2] - turn * v
    z = w / third
    y = v / second - turn * z
    return -slope[0] / xx - left * y - down * z, y, z


class _Mesh:
    """A mesh whose edges collapse.

    ``corners[v]`` lists the corners at a vertex, of faces that are there: corner 3 f + k of face f.
    ``history[v]`` sums the planes of the faces that a vertex stands for, ``around[v]`` those of the
    faces around it now. A vertex of which the faces are no ring or fan is stuck.
    """

    def __init__(
        self, vertices: FloatArray, faces: IntArray, limit: float, keeps_border: bool
    ) -> None:
        count = len(vertices)
        self.limit, self.is_bounded = limit, isfinite(limit)
        self.place: list[_Vector] = [tuple(row) for row in vertices.tolist()]
        self.vertex: list[int] = faces.ravel().tolist()
        self.corners: list[list[int]] = [[] for _ in range(count)]
        for c, v in enumerate(self.vertex):
            self.corners[v].append(c)
        self.face_count, self.dropped = len(faces), 0
        self.is_border, self.is_stuck = [False] * count, [False] * count
        for v in range(count):
            self._survey(v)
        self.is_fixed = list(self.is_border) if keeps_border else [False] * count
        self.stamp = [0] * count
        self.around: list[_Planes] = [(0.0,) * 6] * count
        for f in range(len(faces)):
            self._count_face(f, 1.0)
        if self.is_bounded:  # planes alone would let a tip of the border draw back
            for v in np.flatnonzero(self.is_border).tolist():
                self.around[v] = _add_planes(self.around[v], 1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
        self.history: list[_Quadric] = [(planes, (0.0, 0.0, 0.0), 0.0) for planes in self.around]
        self.heap: list[_Candidate] = []

    def simplify(self, goal: int) -> None:
        """Collapse edges until so many faces are left.

        What was turned down may fit when all around it has changed: the edges come again, while
        that takes a thousandth of the faces.
        """
        while True:
            before = self.face_count
            self._fill()
            while self.face_count > goal and self.heap:
                edge = heappop(self.heap)
                if self._is_current(edge):
                    self._collapse(edge)
            if self.face_count <= goal or before - self.face_count <= before // 1000:
                return

    def _head(self, c: int) -> int:
        return self.vertex[c - 2 if c % 3 == 2 else c + 1]

    def _tail(self, c: int) -> int:
        return self.vertex[c + 2 if c % 3 == 0 else c - 1]

    def _ring(self, v: int) -> list[int]:
        """Return the neighbours of a vertex, in the order in which its faces have them."""
        ring = [w for c in self.corners[v] for w in (self._head(c), self._tail(c))]
        return list(dict.fromkeys(ring))

    def _survey(self, v: int) -> None:
        """Tell whether the faces around a vertex are one ring or, at a border, one fan."""
        corners = self.corners[v]
        if not corners:
            return
        # Around the vertex each face leads from one neighbour to the next.
        sides = [(self._head(c), self._tail(c)) for c in corners]
        after = dict(sides)
        tails = {tail for _, tail in sides}
        fans = [head for head, _ in sides if head not in tails]
        start = at = fans[-1] if fans else sides[0][0]
        # Once around: along the ring, or along the fan from its open end on.
        steps = 0
        while steps < len(sides) and at in after and (not steps or at != start):
            at, steps = after[at], steps + 1
        self.is_border[v] = bool(fans)
        x, y, z = self.place[v]
        self.is_stuck[v] = (
            not isfinite(x + y + z)
            or len(after) < len(sides)
            or any(v in side or side[0] == side[1] for side in sides)
            or len(fans) > 1
            or steps != len(sides)
            or (at in after if fans else at != start)
        )

    def _count_sides(self, v: int, w: int) -> int:
        """Return the number of faces at an edge."""
        if len(self.corners[w]) < len(self.corners[v]):
            v, w = w, v
        return sum(self._head(c) == w or self._tail(c) == w for c in self.corners[v])

    def _count_face(self, f: int, sign: float) -> None:
        """Add or take away what a face and its open sides say of where its vertices may be."""
        corners = self.vertex[3 * f : 3 * f + 3]
        a, b, c = (self.place[v] for v in corners)
        across = _cross(_subtract(b, a), _subtract(c, a))
        length = sqrt(_dot(across, across))
        if not length > _TINY:
            return
        normal = across[0] / length, across[1] / length, across[2] / length
        face = _weigh(1.0 if self.is_bounded else length, normal)
        for v in corners:
            self.around[v] = _add_planes(self.around[v], sign, face)
        for v, w in zip(corners, corners[1:] + corners[:1], strict=True):
            if not (self.is_border[v] and self.is_border[w]) or self._count_sides(v, w) != 1:
                continue
            # An open side is held by a plane through it, at a right angle to its face.
            wall = _cross(_subtract(self.place[w], self.place[v]), normal)
            size = _dot(wall, wall)
            if not size > _TINY:
                continue
            side = _weigh((1.0 if self.is_bounded else _BORDER * size) / size, wall)
            self.around[v] = _add_planes(self.around[v], sign, side)
            self.around[w] = _add_planes(self.around[w], sign, side)

    def _sum_planes(self, v: int) -> _Quadric:
        planes, slope, rest = self.history[v]
        if not self.is_bounded:
            planes = _add_planes(planes, 1.0, self.around[v])
        return planes, slope, rest

    def _find_place(self, a: int, b: int) -> tuple[float, _Vector]:
        """Return what the vertex of a collapsed edge costs, and where it belongs."""
        # Both ends' quadrics are added as the middle of the edge sees them.
        half = _scale(0.5, _subtract(self.place[b], self.place[a]))
        back = _scale(-1.0, half)
        total = _add_quadrics(
            _see_from(self._sum_planes(a), half), _see_from(self._sum_planes(b), back)
        )
        xx, xy, xz, yy, yz, zz = total[0]
        weight = xx + yy + zz
        soft = _SOFT * weight
        is_a, is_b = self.is_fixed[a], self.is_fixed[b]
        # A fixed end stays; of two that are not, the one on a border, if the other is on none.
        if not is_a and not is_b:
            is_a, is_b = (
                self.is_border[a] > self.is_border[b],
                self.is_border[b] > self.is_border[a],
            )
        if is_a:
            offset, place = back, self.place[a]
        elif is_b:
            offset, place = half, self.place[b]
        else:
            offset = _find_least((xx + soft, xy, xz, yy + soft, yz, zz + soft), total[1])
            place = _add(_add(self.place[a], half), offset)
        error = max(_evaluate(total, offset), 0.0)
        # So of edges that cost nothing else the shortest is the first.
        error += soft * (_dot(offset, offset) + _dot(half, half))
        is_plain = self.is_bounded or not error > 0.0
        return error if is_plain else error * sqrt(error / weight), place

    def _propose(self, a: int, b: int) -> None:
        if self.is_stuck[a] or self.is_stuck[b] or (self.is_fixed[a] and self.is_fixed[b]):
            return
        low, high = min(a, b), max(a, b)
        cost, _ = self._find_place(low, high)
        if cost < self.limit:
            heappush(self.heap, (cost, low, high, self.stamp[low] + self.stamp[high]))

    def _fill(self) -> None:
        self.heap = []
        for v in range(len(self.place)):
            for w in self._ring(v):
                if v < w:
                    self._propose(v, w)

    def _is_current(self, edge: _Candidate) -> bool:
        _, low, high, stamp = edge
        is_there = self.corners[low] and self.corners[high]
        return bool(is_there) and self.stamp[low] + self.stamp[high] == stamp

    def _collapse(self, edge: _Candidate) -> None:
        _, a, b, _ = edge
        if self.is_fixed[b]:
            a, b = b, a
        if len(self.corners[a]) + len(self.corners[b]) > _MOST_FACES:
            return
        if self._is_tetrahedron(a):
            self._drop(edge)
            return
        _, place = self._find_place(a, b)
        if self._stays_manifold(a, b) and not (
            self._turns_over(a, b, place) or self._turns_over(b, a, place)
        ):
            self._merge(a, b, place)
            for w in self._ring(a):
                self._propose(a, w)

    def _is_tetrahedron(self, v: int) -> bool:
        """Tell whether a vertex is one of four that are a piece of their own."""
        return all(
            len(self.corners[w]) == 3 and not self.is_border[w] and not self.is_stuck[w]
            for w in [v, *self._ring(v)]
        )

    def _drop(self, edge: _Candidate) -> None:
        """Drop a tetrahedron: it cannot shrink but to a point, which moves all of it."""
        if self.is_bounded:
            return
        across = longest = 0.0
        tips = [*self._ring(edge[1]), edge[1]]
        for v in tips:
            for c in self.corners[v]:
                side = _subtract(self.place[self._head(c)], self.place[v])
                normal = _cross(side, _subtract(self.place[self._tail(c)], self.place[v]))
                across += sqrt(_dot(normal, normal))
                longest = max(longest, _dot(side, side))
        cost = (
            across * longest * sqrt(longest)
        )  # each face was met three times: once for each vertex
        if edge[0] < cost:
            heappush(self.heap, (cost, *edge[1:]))
            return
        for c in self.corners[edge[1]] + self.corners[tips[0]]:
            self._forget(c // 3)
        for v in tips:
            self.corners[v] = []
        self.face_count -= 4
        self.dropped += 1

    def _forget(self, f: int) -> None:
        """Leave a face out of those that are there."""
        self.vertex[3 * f : 3 * f + 3] = [-1, -1, -1]

    def _stays_manifold(self, a: int, b: int) -> bool:
        """Check the link condition: all neighbours in common are those of common faces.

        What lies beyond a fixed border may come to have an edge or a face there, too: none is made
        of fixed vertices alone.
        """
        apexes = [
            self._tail(c) if self._head(c) == b else self._head(c)
            for c in self.corners[a]
            if b in (self._head(c), self._tail(c))
        ]
        if any(self.is_stuck[apex] for apex in apexes):
            return False
        around_a, around_b = set(self._ring(a)), set(self._ring(b))
        if len(around_a & around_b) != len(apexes):
            return False
        if self.is_fixed[a]:
            faces = [(self._head(c), self._tail(c)) for c in self.corners[b]]
            made = [(w,) for w in around_b - around_a] + faces
            if any(a not in ends and all(self.is_fixed[w] for w in ends) for ends in made):
                return False
        if len(apexes) == 2:
            return not (self.is_border[a] and self.is_border[b])
        return len(self.corners[a]) + len(self.corners[b]) > 2

    def _turns_over(self, v: int, w: int, place: _Vector) -> bool:
        """Tell whether a face at v, and not at w, would turn by more than most when v moves."""
        old = self.place[v]
        for c in self.corners[v]:
            if w in (self._head(c), self._tail(c)):
                continue
            s, t = self.place[self._head(c)], self.place[self._tail(c)]
            before = _cross(_subtract(s, old), _subtract(t, old))
            now = _cross(_subtract(s, place), _subtract(t, place))
            lengths = sqrt(_dot(before, before)) * sqrt(_dot(now, now))
            if lengths > 0.0:
                if not _dot(before, now) > _LEAST_COSINE * lengths:
                    return True
            elif _dot(before, before) > 0.0:
                return True
        return False

    def _merge(self, a: int, b: int, place: _Vector) -> None:
        of_a = {c // 3 for c in self.corners[a]}
        if not self.is_bounded:
            for c in self.corners[a]:
                self._count_face(c // 3, -1.0)
            for c in self.corners[b]:
                if c // 3 not in of_a:
                    self._count_face(c // 3, -1.0)
        # The planes that both stand for, as the new place sees them.
        self.history[a] = _add_quadrics(
            _see_from(self.history[a], _subtract(place, self.place[a])),
            _see_from(self.history[b], _subtract(place, self.place[b])),
        )
        self.place[a] = place
        for c in self.corners[b]:
            # Faces at both ends vanish; the others get the new vertex as their corner.
            if c // 3 in of_a:
                for k in range(3 * (c // 3), 3 * (c // 3) + 3):
                    if self.vertex[k] != b:
                        self.corners[self.vertex[k]].remove(k)
                self._forget(c // 3)
                self.face_count -= 1
            else:
                self.vertex[c] = a
                self.corners[a].append(c)
        self.corners[b] = []
        # What was proposed of either before has another stamp.
        self.stamp[a] += self.stamp[b] + 1
        self.is_border[a] |= self.is_border[b]
        self.is_fixed[a] |= self.is_fixed[b]
        if not self.is_bounded:
            self.around[a] = (0.0,) * 6
            for c in self.corners[a]:
                self._count_face(c // 3, 1.0)
