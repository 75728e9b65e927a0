"""Normals from positions: a plane through as many neighbours as noise and curvature allow.

::

    nested neighbourhoods ── moments ──> planes ── noise of the cell ──> the best of each point

The result has no side yet: `orientation` finds it.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.applications.surface.types.lattice import cells_of, number_keys, pack_places
from hpcapp.applications.surface.types.points import BoolArray, Float32Array, FloatArray, IntArray

__all__ = ["MARGIN", "estimate_normals", "keep_directions"]

_COUNTS = (8, 12, 17, 24, 34)
_MORE_COUNTS = (34, 48, 68, 96)
_NOISE_COUNT = 1  # which of them the noise is judged by
_LEAST = 4  # neighbours that a plane is fitted to
_REACH = 12.0  # spacings: farther points are no neighbours
_CELL = 5.0  # spacings: the noise is that of the median point of a cell
_BIAS = 0.2  # how much of the residual beyond the noise bends the normal
_TINY = 1e-6  # spacings: of the noise at least, so that every result has a direction
_TIED = 1.0 + 1e-6  # by how much farther points must lie: less may be rounding
_ROWS_AT_ONCE = 1 << 13  # what is made of them stays small
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_STEPS = 24  # of Newton's method: a double root takes a bit each

MARGIN = _REACH + _CELL * 3.0**0.5
"""Spacings: as far as what decides over a normal lies."""


def estimate_normals(
    positions: FloatArray, asked: BoolArray, low: FloatArray, spacing: float
) -> Float32Array:
    """Estimate the normals of points, without a side.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        Of a cloud, or of a region of it and all points within `MARGIN`; in its order.
    asked : ndarray of bool, shape (n,)
        The points whose normals are wanted.
    low : ndarray of float64, shape (3,)
        The least coordinates of the cloud.
    spacing : float
        Of the cloud, in length units of the input.

    Returns
    -------
    ndarray of float32, shape (m, 3)
        Of the points that were asked for. The length is the standard deviation of the points
        around the plane, in length units of the input.

    Notes
    -----
    Planes are fitted to the 8, 12, 17, 24 and 34 nearest points; to 48, 68 and 96 where the
    largest of these is the best. One through k points within the
    radius r, which s is the residual of, is expected to be wrong by

        e^2 = (4 S^2 / k + 0.2 max(s^2 - S^2, 0)) / r^2

    where S is the noise: the residual of the 12 nearest, that of the median point in a cell of 5
    spacings. The first part is what noise does, the second what curvature, edges and other
    sheets do that a larger neighbourhood takes in. The plane with the least e is taken.

    Neighbours are those nearer than the first that is left out, so that nothing depends on the
    order of points equally far away; what is summed is summed by distance, then in their order.
    """
    cells = np.floor(cells_of(positions, low, _CELL * spacing)).astype(np.int64)
    _, cell_of = number_keys(pack_places(cells))
    wanted = np.zeros(int(cell_of.max(initial=-1)) + 1, np.bool_)
    wanted[cell_of[asked]] = True
    rows = np.flatnonzero(wanted[cell_of])
    search = _Search(positions, _REACH * spacing)
    planes = _Planes.join([search.fit(some, _COUNTS) for some in _cut(rows)])
    noise = _find_noise(planes.squares[:, _NOISE_COUNT], cell_of[rows])
    chosen = _choose(planes, noise)
    vectors = planes.take(chosen, _TINY * spacing)
    last = np.flatnonzero((chosen == len(_COUNTS) - 1) & asked[rows])
    for some in _cut(last):
        more = search.fit(rows[some], _MORE_COUNTS)
        vectors[some] = more.take(_choose(more, noise[some]), _TINY * spacing)
    return vectors[asked[rows]].astype(np.float32)


def keep_directions(vectors: Float32Array, normals: FloatArray | Float32Array) -> Float32Array:
    """Give normals that are known already the lengths of estimated ones.

    Parameters
    ----------
    vectors : ndarray of float32, shape (m, 3)
        What `estimate_normals` has returned.
    normals : ndarray of float64 or float32, shape (m, 3)
        Unit length.

    Returns
    -------
    ndarray of float32, shape (m, 3)
    """
    wide = vectors.astype(np.float64)
    lengths = np.sqrt(np.einsum("ij,ij->i", wide, wide))
    kept: Float32Array = (normals * lengths[:, None]).astype(np.float32)
    return kept


class _Search:
    """The neighbours of points."""

    def __init__(self, positions: FloatArray, reach: float) -> None:
        self._positions, self._reach = positions, reach
        self._tree = cKDTree(positions)

    def fit(self, rows: IntArray, counts: tuple[int, ...]) -> _Planes:
        """Fit planes to so many neighbours of some points."""
        far, near = self._tree.query(
            self._positions[rows], counts[-1] + 1, distance_upper_bound=self._reach
        )
        is_near = far * _TIED < far[:, -1:]
        near = np.where(is_near, near, rows[:, None])[:, :-1]
        _order_ties(far[:, :-1], near)
        arms = self._positions[near] - self._positions[rows, None]
        starts = (0, *counts[:-1])

        def add(values: FloatArray) -> FloatArray:
            return np.cumsum(np.add.reduceat(values, starts, axis=1), axis=1)

        held = np.maximum(add(is_near[:, :-1].astype(np.float64)), 1.0)
        mean = [add(arms[..., axis]) / held for axis in range(3)]
        spread = [add(arms[..., i] * arms[..., j]) / held - mean[i] * mean[j] for i, j in _PAIRS]
        return _Planes.of(held, np.stack(spread))


class _Planes:
    """Planes through several neighbourhoods of each point.

    Parameters
    ----------
    held : ndarray of float64, shape (n, k)
        Points in each.
    squares : ndarray of float64, shape (n, k)
        Variance across the plane.
    extent : ndarray of float64, shape (n, k)
        Variance along the plane, of both directions together; zero where there is no plane.
    spread : ndarray of float64, shape (6, n, k)
        Covariances, in the order of `_PAIRS`.
    """

    def __init__(
        self, held: FloatArray, squares: FloatArray, extent: FloatArray, spread: FloatArray
    ) -> None:
        self.held, self.squares, self.extent, self.spread = held, squares, extent, spread

    @classmethod
    def of(cls, held: FloatArray, spread: FloatArray) -> _Planes:
        """Return the planes of some covariances."""
        least = _least_eigenvalues(spread)
        extent = spread[0] + spread[1] + spread[2] - least
        extent[held < _LEAST] = 0.0
        return cls(held, least * (held / np.maximum(held - 3.0, 1.0)), extent, spread)

    @classmethod
    def join(cls, parts: list[_Planes]) -> _Planes:
        """Return the planes of several groups of points as one."""
        columns = [(p.held, p.squares, p.extent) for p in parts]
        held, squares, extent = (np.concatenate(column) for column in zip(*columns, strict=True))
        return cls(held, squares, extent, np.concatenate([p.spread for p in parts], axis=1))

    def take(self, chosen: IntArray, least: float) -> FloatArray:
        """Return one normal of each point, as long as its residual."""
        at = np.arange(len(chosen)), chosen
        normals = _least_eigenvectors(self.spread[:, at[0], at[1]])
        return normals * np.maximum(np.sqrt(self.squares[at]), least)[:, None]


def _least_eigenvalues(spread: FloatArray) -> FloatArray:
    """Return the least eigenvalues of symmetric 3 x 3 matrices, none of them negative.

    Newton's method finds the least root of the characteristic polynomial from below, where it is
    falling and convex. It takes sums and products alone, whose bits are the same on any processor.
    """
    xx, yy, zz, xy, xz, yz = spread
    trace = xx + yy + zz
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    root = np.zeros_like(trace)
    for _ in range(_STEPS):
        value = ((root - trace) * root + minors) * root - determinant  # negative: below all roots
        slope = (3.0 * root - 2.0 * trace) * root + minors
        falling = (value < 0.0) & (slope > 0.0)
        if not falling.any():
            break
        root += np.where(falling, -value / np.where(falling, slope, 1.0), 0.0)
    least: FloatArray = np.minimum(root, trace / 3.0)
    return least


def _least_eigenvectors(spread: FloatArray) -> FloatArray:
    """Return unit vectors of the least eigenvalues, one a matrix.

    The longest cross product of two rows of the matrix less the eigenvalue is taken.
    """
    xx, yy, zz, xy, xz, yz = spread
    least = _least_eigenvalues(spread)
    rows = (xx - least, xy, xz), (xy, yy - least, yz), (xz, yz, zz - least)
    crosses = np.stack(
        [_cross(rows[0], rows[1]), _cross(rows[0], rows[2]), _cross(rows[1], rows[2])]
    )
    lengths = (crosses * crosses).sum(axis=1)  # (3, n)
    longest = np.argmax(lengths, axis=0)
    at = np.arange(len(longest))
    vectors, squares = crosses[longest, :, at], lengths[longest, at]
    is_flat = squares > 0.0
    vectors[~is_flat] = (0.0, 0.0, 1.0)
    units: FloatArray = vectors / np.sqrt(np.where(is_flat, squares, 1.0))[:, None]
    return units


def _cross(a: tuple[FloatArray, ...], b: tuple[FloatArray, ...]) -> FloatArray:
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _choose(planes: _Planes, noise: FloatArray) -> IntArray:
    """Return which plane of each point is expected to be the best."""
    square = noise[:, None]
    beyond = np.maximum(planes.squares - square, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = (4.0 * square / planes.held + _BIAS * beyond) / planes.extent
    best: IntArray = np.argmin(np.where(planes.extent > 0.0, error, np.inf), axis=1)
    return best


def _find_noise(squares: FloatArray, cell_of: IntArray) -> FloatArray:
    """Return the median of the residuals' squares in the cell of each point."""
    order = np.lexsort((squares, cell_of))
    ends = np.cumsum(np.bincount(cell_of))
    starts = np.append(0, ends[:-1])
    middles = np.minimum((starts + ends) // 2, len(order) - 1)
    of_cell: FloatArray = squares[order[middles]]
    return of_cell[cell_of]


def _order_ties(far: FloatArray, near: IntArray) -> None:
    """Bring neighbours that are equally far away into their order, in place."""
    is_farther = far[:, 1:] > _TIED * far[:, :-1]
    tied = np.flatnonzero(~is_farther.all(axis=1))
    if len(tied):
        rank = np.cumsum(np.insert(is_farther[tied], 0, False, axis=1), axis=1)
        order = np.lexsort((near[tied], rank), axis=1)
        near[tied] = np.take_along_axis(near[tied], order, axis=1)


def _cut(rows: IntArray) -> list[IntArray]:
    """Cut rows into groups that fit into memory."""
    return [rows[i : i + _ROWS_AT_ONCE] for i in range(0, max(len(rows), 1), _ROWS_AT_ONCE)]
