"""Edges and corners: two or three quadrics around a vertex, joined by max or min.

One quadric rounds an edge off. Where the points around a vertex are two or three smooth pieces,
each piece gets a quadric of its own: a height over the plane across its mean normal. The inside of
a convex edge is where both are negative, which is max; of a concave one, where either is, min.

References
----------
Y. Ohtake, A. Belyaev, M. Alexa, G. Turk, H.-P. Seidel, Multi-level partition of unity implicits,
ACM Trans. Graph. 22 (2003), doi:10.1145/882262.882293.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import find_keys, pack_places, unpack_keys
from hpcapp.geometry.points import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels.constants import BASIS
from hpcapp.kernels.portable.field.feature_blend import join_pieces
from hpcapp.kernels.types.field import PIECES
from hpccomponent.dataclass import dataclass

__all__ = ["fit_features"]

_REACHES = (3, 2)  # cells on each side of a vertex: the wider fit where it holds
_OUTERMOST = 0.15  # what a point at the end of these counts; within a cell of the vertex it is 1
_MOST = 160  # points that a fit looks at; of more, every second or third
_LEAST_WEIGHT, _LEAST_OF_THREE, _LEAST_OF_PIECE = 9.0, 14.0, 2.5

_LEAST_SPREAD = 0.08  # of the normals: 1 - |mean|^2
_NEAR, _LEAST_NEAR = 2.0, 0.02  # cells from the vertex; of the normals there
_GAIN, _GAIN_PER_ROOT = 2.0, 6.0  # variance of one quadric by that of the pieces: the least
_ADEQUATE, _RELATIVE = 2.5, 0.1  # variance of the pieces by the noise, by that of one quadric
_CORRELATION = 0.3  # of what is left over at neighbouring points: more is shape, not noise
_SMALLEST = 2e-4  # a variance that nobody sees
_KNOWN = 0.7  # of the noise: pieces that leave less have followed it
_ENOUGH = 1.2  # times the noise: two pieces that leave no more need no third one
_THIRD = 1.3  # a third piece must lower the variance by as much
_LEAST_TURN = 0.25  # 1 - cos of the angle of a third piece's seed to both others
_ANGLE = 0.82  # cos of the least angle between the mean normals of two pieces

_NORMAL_VARIANCE = 0.07  # of the slopes that normals tell
_LEAST_LAM = 0.2  # of one quadric: two crossing planes are one too, but not by their normals
_CONE = 0.7  # cos of the angle from which on a normal tells a piece nothing
_TURN = 0.2  # squared cells that a point may be off, for a squared difference of normals
_CURVATURE = 0.08  # what a piece bends by, in cells
_EXACT = 1e-5  # the least variance of a position
_LEAST_SLOPE = 0.04  # squared
_ROUNDS, _BY_PIECES = 6, 3  # of taking points to pieces; from this one on by their quadrics
_TIED = 1e-5  # costs and cosines that only rounding tells apart: the first one counts
_HEIGHT = 6  # coefficients of a piece over its plane
_BATCH = 256


@dataclass(frozen=True, slots=True, eq=False)
class _Around:
    """The points around m vertices, p each: those that are none weigh 0."""

    at: FloatArray
    normals: FloatArray
    weights: FloatArray

    def take(self, rows: IntArray | BoolArray) -> _Around:
        return _Around(self.at[rows], self.normals[rows], self.weights[rows])

    @property
    def totals(self) -> FloatArray:
        total: FloatArray = self.weights.sum(axis=1)
        return total


@dataclass(frozen=True, slots=True, eq=False)
class _Models:
    """What m vertices have around them: k pieces each, and how they are joined."""

    axes: FloatArray  # (m, k, 3)
    pieces: FloatArray  # (m, k, 10)
    first: IntArray  # the piece outside of the inner joint
    joints: IntArray
    sums: FloatArray  # of squared distances; infinite where there is no such model
    residuals: FloatArray  # (m, p), distances of the points from the joined pieces


def fit_features(
    vertices: IntArray,
    cells: IntArray,
    offsets: IntArray,
    local_positions: FloatArray,
    normals: FloatArray,
    noise: float,
    threads: int = 1,
) -> tuple[Float32Array, ByteArray]:
    """Fit joined quadrics around those vertices where one quadric is not enough.

    `vertices` (v,) are sorted keys of corners, `cells` (c,) those of all cells with points within
    three cells of one; by `offsets` (c + 1,), cell i holds the points offsets[i] to offsets[i + 1].
    Positions (n, 3) are relative to the centre of the point's cell, in cells, with normals (n, 3);
    `noise` is the variance of positions along the normals, in cells squared. Return the pieces
    (v, 3, 10) and joints (v,) of `types.field.Features`; 255 where one quadric does.

    Notes
    -----
    Seeds are the normal that turns farthest from the mean, and the one that turns farthest from
    it. Points go to the nearer normal, three times; then to the quadric that they lie nearer to in
    place and normal. A third piece begins at the normal that both explain worst.

    Pieces are believed where they leave a good deal less than one quadric, and where what they
    leave is as small as the noise, or looks like noise: neighbours leave unlike amounts.
    """
    del threads  # numpy runs on one
    pieces = np.zeros((len(vertices), PIECES, BASIS), np.float32)
    joints = np.full(len(vertices), 255, np.uint8)
    for start in range(0, len(vertices), _BATCH):
        rows = np.arange(start, min(start + _BATCH, len(vertices)))
        for reach in _REACHES:
            around = _gather(vertices[rows], cells, offsets, local_positions, normals, reach)
            asked, is_joined, pieces_of, joints_of = _find(around, noise)
            pieces[rows[asked[is_joined]]] = pieces_of
            joints[rows[asked[is_joined]]] = joints_of
            rows = rows[asked[~is_joined]]  # what has no model is asked again, within less
    return pieces, joints


def _gather(
    vertices: IntArray,
    cells: IntArray,
    offsets: IntArray,
    local: FloatArray,
    normals: FloatArray,
    reach: int,
) -> _Around:
    """Gather the points of the cells around some vertices, in the order of the cells."""
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach)] * 3, indexing="ij"), axis=-1)
    steps = steps.reshape(-1, 3)  # (s, 3): from a vertex to the cells around it
    # (v, s): the row of each of these cells, how many points it has, and the first of them.
    rows = find_keys(cells, pack_places(unpack_keys(vertices)[:, None] + steps))
    counts = np.where(rows < len(cells), np.diff(offsets, append=offsets[-1])[rows], 0)
    starts = offsets[np.minimum(rows, len(cells))]
    # Of a vertex with too many points, every second, or third, is taken.
    totals = counts.sum(axis=1)
    every = np.maximum(1, -(-totals // _MOST))
    # (n,): all points of all vertices: the vertex, the how-manieth of it, the row of the point,
    # and from the vertex to the middle of its cell.
    vertex = np.repeat(np.arange(len(vertices)), totals)
    number = np.arange(len(vertex)) - np.repeat(np.cumsum(totals) - totals, totals)
    flat = counts.reshape(-1)
    within = np.arange(len(vertex)) - np.repeat(np.cumsum(flat) - flat, flat)
    point = np.repeat(starts.reshape(-1), flat) + within
    shift = np.repeat(np.tile(steps + 0.5, (len(vertices), 1)), flat, axis=0)
    kept = number % every[vertex] == 0
    vertex, place = vertex[kept], (number // every[vertex])[kept]
    # (v, p, 3): padded to the most points of a vertex; those that are none weigh 0.
    most = int(place.max(initial=0)) + 1
    at, normal = np.zeros((2, len(vertices), most, 3))
    weights = np.zeros((len(vertices), most))
    at[vertex, place] = local[point[kept]] + shift[kept]
    normal[vertex, place] = normals[point[kept]]
    far = np.maximum(np.abs(at[vertex, place]).max(axis=1), 1.0)
    weights[vertex, place] = 1.0 - (1.0 - _OUTERMOST) * (far - 1.0) / (reach - 1.0)
    return _Around(at, normal, weights)


def _find(around: _Around, noise: float) -> tuple[IntArray, BoolArray, Float32Array, ByteArray]:
    """Return where one quadric is not enough, which of these have joined ones, and these."""
    # Whether normals turn at all, also near the vertex: else one quadric does. All of shape (v,).
    totals = around.totals
    means = (around.weights[:, :, None] * around.normals).sum(axis=1)
    spread = 1.0 - (means**2).sum(axis=1) / np.maximum(totals, 1e-300) ** 2
    near = ((np.abs(around.at).max(axis=2) <= _NEAR) & (around.weights > 0.0)).astype(np.float64)
    inner = (near[:, :, None] * around.normals).sum(axis=1)
    turned = 1.0 - (inner**2).sum(axis=1) / np.maximum(near.sum(axis=1), 1.0) ** 2
    is_asked = (totals >= _LEAST_WEIGHT) & (spread >= _LEAST_SPREAD) & (turned >= _LEAST_NEAR)
    rows = np.flatnonzero(is_asked)
    # (m,) from here on: the variance that one quadric leaves, per degree of freedom, and by how
    # much that of the pieces must be smaller.
    around, totals, means = around.take(rows), totals[rows], _unit(means[rows])
    one = _fit_one(around, noise) / np.maximum(1.0, totals - BASIS)
    bound = _GAIN + _GAIN_PER_ROOT / np.sqrt(totals)
    least = max(_KNOWN * noise, _SMALLEST)
    kept = one >= bound * least
    rows, around, totals, means = rows[kept], around.take(kept), totals[kept], means[kept]
    one, bound = one[kept], bound[kept]
    if not len(rows):
        pieces = np.empty((0, PIECES, BASIS), np.float32)
        return rows, np.empty(0, np.bool_), pieces, np.empty(0, np.uint8)
    # The best two pieces, and the best three; a third one must be worth it.
    two = _split(around, _seed_two(around, means), noise)
    three = _split(around, _seed_three(around, two.axes), noise)
    of_two = two.sums / np.maximum(1.0, totals - 2.0 * _HEIGHT)
    of_three = three.sums / np.maximum(1.0, totals - 3.0 * _HEIGHT)
    is_turned = _turn_most(around, two.axes)[1] > _LEAST_TURN
    added = _SMALLEST + _KNOWN * noise
    is_three = (totals >= _LEAST_OF_THREE) & is_turned & (of_three < np.inf)
    is_three &= of_two >= _ENOUGH * noise + _SMALLEST
    is_three &= of_three + added < (of_two + added) / _THIRD
    # The better model is believed if its pieces turn enough, leave much less than one quadric, and
    # leave what looks like noise.
    variance = np.where(is_three, of_three, of_two)
    apart = np.where(is_three, _are_apart(three.axes), _are_apart(two.axes))
    residuals = np.where(is_three[:, None], three.residuals, two.residuals)
    adequate = (variance < _ADEQUATE * noise + _SMALLEST) | (variance < _RELATIVE * one)
    good = (variance < np.inf) & apart & (one > bound * np.maximum(variance, least))
    unsure = np.flatnonzero(good & ~adequate)
    adequate[unsure] = _correlate(around.take(unsure), residuals[unsure]) < _CORRELATION
    good &= adequate
    # (m, 3, 10): the pieces in the order of their joint; of two, the second stands twice.
    first = np.where(is_three, three.first, two.first)
    size = np.where(is_three, 3, 2)
    second, third = (first + 1) % size, np.where(is_three, (first + 2) % 3, (first + 1) % 2)
    order = np.stack([first, second, third], axis=1)
    padded = np.concatenate([two.pieces, two.pieces[:, :1]], axis=1)
    pieces = np.where(is_three[:, None, None], three.pieces, padded)
    pieces = np.take_along_axis(pieces, order[:, :, None], axis=1)
    joints = np.where(is_three, three.joints, two.joints)
    return rows, good, pieces[good].astype(np.float32), joints[good].astype(np.uint8)


def _seed_two(around: _Around, means: FloatArray) -> FloatArray:
    """Return the normal farthest from the mean, and the one farthest from that, (m, 2, 3)."""
    rows, seeds = np.arange(len(means)), [means]
    for _ in range(2):
        worst, _ = _turn_most(around, seeds[-1][:, None])
        seeds.append(around.normals[rows, worst])
    return np.stack(seeds[1:], axis=1)


def _turn_most(around: _Around, axes: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return which point's normal turns farthest from all axes, and 1 - cos of by how much."""
    along = np.einsum("mpi,mki->mpk", around.normals, axes).max(axis=2)
    off = np.where(around.weights > 0.0, 1.0 - along, -np.inf)
    most = off.max(axis=1)
    worst: IntArray = (off >= most[:, None] - _TIED).argmax(axis=1)  # the first of several
    return worst, most


def _seed_three(around: _Around, axes: FloatArray) -> FloatArray:
    """Add the normal that two pieces explain worst to their axes, (m, 3, 3)."""
    worst = around.normals[np.arange(len(axes)), _turn_most(around, axes)[0]]
    return np.concatenate([axes, worst[:, None]], axis=1)


def _split(around: _Around, axes: FloatArray, noise: float) -> _Models:
    """Take each point to a piece, by normals at first, then by what it is to their quadrics."""
    size = axes.shape[1]
    alive = np.ones(len(axes), np.bool_)
    of = np.zeros(around.weights.shape, np.int64)  # (m, p): the piece of each point
    for turn in range(_ROUNDS):
        # (m, k, p): what each point would cost each piece.
        if turn < _BY_PIECES:
            costs = 2.0 - 2.0 * np.einsum("mpi,mki->mkp", around.normals, axes)
        else:
            pieces = _fit_pieces(around, of, axes, noise)
            distances, turned = _measure(pieces, around.at)
            turns = 2.0 - 2.0 * np.einsum("mpi,mkpi->mkp", around.normals, turned)
            costs = _TURN * turns + distances**2
        of = _take_cheapest(costs)
        # (m, k, p): the weight of each point in the piece that has it. A model with too light a
        # piece is given up; the axes of others become the means of their normals.
        members = (of[:, None] == np.arange(size)[:, None]) * around.weights[:, None]
        alive &= (members.sum(axis=2) >= _LEAST_OF_PIECE).all(axis=1)
        new = _unit(np.einsum("mkp,mpi->mki", members, around.normals))
        axes = np.where(alive[:, None, None], new, axes)
    pieces = _fit_pieces(around, of, axes, noise)
    distances, _ = _measure(pieces, around.at)
    # Every way to join the pieces, of which the one that leaves least is kept.
    best, first, joints = np.full(len(axes), np.inf), *np.zeros((2, len(axes)), np.int64)
    residuals = np.zeros_like(around.weights)
    for a in range(3 if size == 3 else 1):
        b = (a + 1) % size
        c = (a + 2) % 3 if size == 3 else b
        for joint in range(4):
            of_all = np.full((len(axes), 1), joint)
            f = join_pieces(distances[:, a], distances[:, b], distances[:, c], of_all)
            sums = (around.weights * f * f).sum(axis=1)
            better = alive & (sums < best * (1.0 - _TIED) - _TIED)
            best[better], first[better], joints[better] = sums[better], a, joint
            residuals[better] = f[better]
    return _Models(axes, pieces, first, joints, best, residuals)


def _take_cheapest(costs: FloatArray) -> IntArray:
    """Return the first of the cheapest pieces of each point, given (m, k, p)."""
    of, least = np.zeros((len(costs), costs.shape[2]), np.int64), costs[:, 0].copy()
    for piece in range(1, costs.shape[1]):
        is_cheaper = costs[:, piece] < least - _TIED
        of[is_cheaper], least[is_cheaper] = piece, costs[:, piece][is_cheaper]
    return of


def _fit_one(around: _Around, noise: float) -> FloatArray:
    """Return the sum of squared distances to one quadric fitted to all points."""
    p, w = around.at, around.weights
    basis, slopes = _basis(p), _basis_slopes(p)  # (m, p, 10) and (m, p, 3, 10)
    lam = max(noise / _NORMAL_VARIANCE, _LEAST_LAM)
    left, _ = _sum_squares(basis, w, np.zeros_like(w))
    right = np.zeros((len(w), BASIS))
    for axis in range(3):
        squares, products = _sum_squares(slopes[:, :, axis], lam * w, around.normals[:, :, axis])
        left += squares
        right += products
    left += 1e-9 * (w > 0.0).sum(axis=1)[:, None, None] * np.eye(BASIS)
    quadrics = np.linalg.solve(left, right[:, :, None])[:, :, 0].astype(np.float64)
    distances, _ = _measure(quadrics[:, None], p)
    sums: FloatArray = (w * distances[:, 0] ** 2).sum(axis=1)
    return sums


def _fit_pieces(around: _Around, of: IntArray, axes: FloatArray, noise: float) -> FloatArray:
    """Fit a height over the plane across its axis to the points of each piece, (m, k, 10)."""
    exact = max(noise, _EXACT)
    lam, ridge = exact / _NORMAL_VARIANCE, exact / _CURVATURE**2
    pieces = []
    for piece in range(axes.shape[1]):
        axis = axes[:, piece]
        t, u = _across(axis)
        w = around.weights * (of == piece)
        # (m, p): the points and their normals in the frame of the plane, and their height over it.
        x, y, height = (np.einsum("mpi,mi->mp", around.at, a) for a in (t, u, axis))
        nx, ny, along = (np.einsum("mpi,mi->mp", around.normals, a) for a in (t, u, axis))
        one, none = np.ones_like(x), np.zeros_like(x)
        # Slopes of the height that normals tell, but for those that are nearly in the plane.
        has_slope = along > _CONE
        along = np.where(has_slope, along, 1.0)
        slope_weight = lam * w * np.where(has_slope, (along - _CONE) / (1.0 - _CONE), 0.0)
        # (m, 6, 6) and (m, 6): the height and both slopes, in 1, x, y, xx, xy, yy.
        left, right = np.zeros((len(axis), 6, 6)), np.zeros((len(axis), 6))
        for row, weight, value in (
            ([one, x, y, x * x, x * y, y * y], w, height),
            ([none, one, none, 2.0 * x, y, none], slope_weight, -nx / along),
            ([none, none, one, none, x, 2.0 * y], slope_weight, -ny / along),
        ):
            squares, products = _sum_squares(np.stack(row, axis=2), weight, value)
            left += squares
            right += products
        left += np.diag([1e-6] * 3 + [ridge] * 3)
        b = np.linalg.solve(left, right[:, :, None])[:, :, 0]
        # f = height above the plane - the fitted one, as a quadric in x, y, z: the square part is
        # the height's Hessian in the plane's two vectors.
        bent = np.stack(
            [np.stack([b[:, 3], b[:, 4] / 2], 1), np.stack([b[:, 4] / 2, b[:, 5]], 1)], 1
        )
        plane = np.stack([t, u], axis=1)
        square = -np.einsum("mai,mab,mbj->mij", plane, bent, plane)
        linear = axis - b[:, 1:2] * t - b[:, 2:3] * u
        mixed = [2.0 * square[:, i, j] for i, j in ((0, 1), (1, 2), (2, 0))]
        pure = [square[:, i, i] for i in range(3)]
        pieces.append(np.column_stack([-b[:, 0], linear, *pure, *mixed]))
    return np.stack(pieces, axis=1)


def _sum_squares(
    rows: FloatArray, weights: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of rows (m, p, k): (m, k, k) and (m, k)."""
    weighed = np.swapaxes(rows * weights[:, :, None], 1, 2)
    return weighed @ rows, (weighed @ values[:, :, None])[:, :, 0]


def _across(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors across each axis.

    T. Duff et al., Building an orthonormal basis, revisited, J. Comput. Graph. Tech. 6 (2017).
    """
    x, y, z = axis.T
    sign = np.where(z < 0.0, -1.0, 1.0)
    s = -1.0 / (sign + z)
    r = x * y * s
    t = np.stack([1.0 + sign * x * x * s, sign * r, -sign * x], axis=1)
    return t, np.stack([r, sign + y * y * s, -y], axis=1)


def _measure(pieces: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return signed distances to first order (m, k, p), and where gradients point (m, k, p, 3)."""
    values = pieces @ np.swapaxes(_basis(at), 1, 2)
    each = np.moveaxis(_basis_slopes(at), 2, 0)
    slopes = np.stack([pieces @ np.swapaxes(of, 1, 2) for of in each], axis=-1)
    steep = np.sqrt(np.maximum((slopes**2).sum(axis=3), _LEAST_SLOPE))
    return values / steep, slopes / steep[..., None]


def _correlate(around: _Around, residuals: FloatArray) -> FloatArray:
    """Return how much the residual of a point is like that of the nearest other one, on average."""
    if not len(residuals):
        return np.empty(0)
    # (m, p, p): squared distances of the points from one another; none from itself.
    gaps = ((around.at[:, :, None] - around.at[:, None]) ** 2).sum(axis=3)
    real = around.weights > 0.0
    gaps = np.where(real[:, None], gaps, np.inf)
    index = np.arange(gaps.shape[1])
    gaps[:, index, index] = np.inf
    first = (gaps <= gaps.min(axis=2, keepdims=True) + _TIED).argmax(axis=2)
    nearest = np.take_along_axis(residuals, first, axis=1)
    squares = np.maximum((around.weights * residuals * residuals).sum(axis=1), 1e-30)
    like: FloatArray = (around.weights * residuals * nearest).sum(axis=1) / squares
    return like


def _are_apart(axes: FloatArray) -> BoolArray:
    """Tell whether all axes of each model are far enough apart."""
    along = np.einsum("mai,mbi->mab", axes, axes)
    k = np.arange(axes.shape[1])
    along[:, k, k] = -1.0
    apart: BoolArray = along.max(axis=(1, 2)) <= _ANGLE
    return apart


def _unit(vectors: FloatArray) -> FloatArray:
    unit: FloatArray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return unit


def _basis(p: FloatArray) -> FloatArray:
    """Return [1, x, y, z, xx, yy, zz, xy, yz, zx] of points, (..., 10)."""
    x, y, z = np.moveaxis(p, -1, 0)
    return np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, y * z, z * x], axis=-1)


def _basis_slopes(p: FloatArray) -> FloatArray:
    """Return the gradients of the basis, (..., 3, 10)."""
    x, y, z = np.moveaxis(p, -1, 0)
    o, i = np.zeros_like(x), np.ones_like(x)
    rows = [
        [o, i, o, o, 2.0 * x, o, o, y, o, z],
        [o, o, i, o, o, 2.0 * y, o, x, z, o],
        [o, o, o, i, o, o, 2.0 * z, o, y, x],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
