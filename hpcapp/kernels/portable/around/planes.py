"""Planes through as many neighbours of each point as noise and curvature allow."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.geometry.points import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels.portable.around.nearest import UNITS, Nearest, cells_of_units, round_positions
from hpccomponent.dataclass import dataclass

__all__ = ["fit_planes"]

_COUNTS = (8, 12, 17, 24, 34)
_MORE_COUNTS = (34, 48, 68, 96)
_NOISE_COUNT = 1  # which of them the noise is judged by
_LEAST = 4.0  # neighbours that a plane is fitted to
_REACH = 12  # spacings: farther points are no neighbours
_BIAS = 0.2  # how much of the residual beyond the noise bends the normal
_TINY = 1e-6  # spacings: of the residual at least, so that every result has a direction
_ROWS_AT_ONCE = 1 << 13  # what is made of them stays small
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

_SHEET_COUNT = 3  # whose points may lie on two sheets
_THICK = 0.3  # spacings: the residual from which on that is asked
_APART = 0.25
"""Residual around two planes, by that around one. Within 3 spacings of an edge of 15 to 45 degrees,
and on a wall of .9 to 2, half the points have .04 to .11, with noise of .1 spacings .16 to .27. Of
single noisy sheets half have .55, and one in a thousand has .3; of balls of 4 spacings .25."""
_SHEET_LEAST, _SHEET_ROUNDS = 4, 3

_STEPS = 24  # of Newton's method: a double root takes a bit each


def fit_planes(
    positions: FloatArray, asked: ByteArray, low: FloatArray, spacing: float, threads: int = 1
) -> Float32Array:
    """Fit a plane to the neighbours of each of the points (n, 3) whose `asked` (n,) is not 0.

    Return their normals (m, 3), either way up, as long as the standard deviation of the points
    around the plane, in length units of the input. A corner of the lattice whose cells of 5
    spacings share one noise lies at `low` (3,).

    Notes
    -----
    Planes are fitted to the 8, 12, 17, 24 and 34 nearest points, the point itself among them; to
    48, 68 and 96 where the largest of these is the best. One through k points within the radius r,
    which s is the residual of, is expected to be wrong by

        e^2 = (4 S^2 / k + 0.2 max(s^2 - S^2, 0)) / r^2

    where S is the noise: the residual of the 12 nearest, that of the median point in a cell. The
    first part is what noise does, the second what curvature, edges and other sheets do that a
    larger neighbourhood takes in. The plane with the least e is taken.

    Where the 24 nearest leave more than .3 spacings, they may lie on both sides of a thin wall or
    of an acute edge: two planes are fitted, to the halves that differ most in height, and twice
    more to the points that each is nearer to. Where these leave .25 of what one plane leaves, or
    less, the residual is theirs, and the normal that of the plane the point is nearer to.

    The k nearest are those nearer than the first that is left out, by more than rounding: nothing
    depends on the order of points equally far away. Distances and sums are those of rounded
    positions, and exact (see `nearest`).
    """
    del threads  # numpy runs on one
    units = round_positions(positions, low, spacing)
    _, cell_of = cells_of_units(units)
    is_asked = asked != 0
    wanted = np.zeros(int(cell_of.max(initial=-1)) + 1, np.bool_)
    wanted[cell_of[is_asked]] = True
    # (r,): all points of the cells in which one is asked for, as these share a noise.
    rows = np.flatnonzero(wanted[cell_of])
    tree = cKDTree(units)
    vectors = np.zeros((len(rows), 3))
    residuals = np.zeros(len(rows))
    planes = [_fit(tree, rows[some], _COUNTS) for some in _cut(len(rows))]
    for some, fitted in zip(_cut(len(rows)), planes, strict=True):
        has_sheet = np.isfinite(fitted.sheets[:, 3])
        # (r,): by what the noise is told. On a thin wall, one plane leaves its thickness as well.
        residuals[some] = np.where(has_sheet, fitted.sheets[:, 3], fitted.squares[:, _NOISE_COUNT])
    noise = _find_noise(residuals, cell_of[rows])
    is_last = np.zeros(len(rows), np.bool_)
    for some, fitted in zip(_cut(len(rows)), planes, strict=True):
        chosen = _choose(fitted, noise[some])
        has_sheet = np.isfinite(fitted.sheets[:, 3])
        vectors[some] = fitted.take(chosen, spacing)
        # The largest neighbourhood is the best so far: still larger ones may be better.
        is_last[some] = (chosen == len(_COUNTS) - 1) & ~has_sheet
    last = np.flatnonzero(is_last & is_asked[rows])
    for some in _cut(len(last)):
        fitted = _fit(tree, rows[last[some]], _MORE_COUNTS)
        vectors[last[some]] = fitted.take(_choose(fitted, noise[last[some]]), spacing)
    single: Float32Array = vectors[is_asked[rows]].astype(np.float32)
    return single


@dataclass(frozen=True, slots=True, eq=False)
class _Planes:
    """Planes through several neighbourhoods of each point, in units; (n, k) each.

    So many points are `held` in each; `squares` is the variance across the plane, `extent` that
    along it, of both directions together, zero where there is no plane; `spread` (6, n, k) are
    covariances, in the order of `_PAIRS`. Where neighbours lie on two sheets, `sheets` (n, 4) has
    the normal of the point's, and the variance across both; else NaN.
    """

    held: FloatArray
    squares: FloatArray
    extent: FloatArray
    spread: FloatArray
    sheets: FloatArray

    def take(self, chosen: IntArray, spacing: float) -> FloatArray:
        """Return one normal of each point, as long as its residual in length units of the input."""
        at = np.arange(len(chosen)), chosen
        normals = _least_eigenvectors(self.spread[:, at[0], at[1]])
        squares = self.squares[at]
        has_sheet = np.isfinite(self.sheets[:, 3])
        normals[has_sheet], squares[has_sheet] = (
            self.sheets[has_sheet, :3],
            self.sheets[has_sheet, 3],
        )
        lengths = np.maximum(np.sqrt(squares), _TINY * UNITS) * (spacing / UNITS)
        return normals * lengths[:, None]


def _fit(tree: cKDTree, rows: IntArray, counts: tuple[int, ...]) -> _Planes:
    """Fit planes to so many neighbours of some points."""
    nearest = Nearest(tree, rows, counts[-1], _REACH)
    order = np.arange(counts[-1])
    held = np.zeros((len(rows), len(counts)))
    spread = np.zeros((len(_PAIRS), *held.shape))
    for column, most in enumerate(counts):
        number = nearest.count(most)
        arms = nearest.arms * (order < number[:, None])[..., None]  # (n, most, 3)
        held[:, column] = np.maximum(number, 1)
        mean = arms.sum(axis=1) / held[:, column, None]
        for row, (i, j) in enumerate(_PAIRS):
            products = (arms[..., i] * arms[..., j]).sum(axis=1)
            spread[row, :, column] = products / held[:, column] - mean[:, i] * mean[:, j]
    least = _least_eigenvalues(spread)
    # (n, k): the trace less the variance across are those along the plane.
    extent = spread[0] + spread[1] + spread[2] - least
    extent[held < _LEAST] = 0.0
    # (n, k): a plane takes three degrees of freedom from what its points leave over.
    squares = least * (held / np.maximum(held - 3.0, 1.0))
    sheets = np.full((len(rows), 4), np.nan)
    if counts == _COUNTS:
        # (t,): points where that is too much for one sheet; then those with neighbours for two.
        thick = np.flatnonzero(squares[:, _SHEET_COUNT] > (_THICK * UNITS) * (_THICK * UNITS))
        number = nearest.count(_COUNTS[_SHEET_COUNT])[thick]
        thick, number = thick[number >= 2 * _SHEET_LEAST], number[number >= 2 * _SHEET_LEAST]
        alone = spread[:, thick, _SHEET_COUNT], squares[thick, _SHEET_COUNT]
        arms = nearest.arms[thick, : _COUNTS[_SHEET_COUNT]]
        sheets[thick] = _find_sheets(arms, number, *alone)
    return _Planes(held, squares, extent, spread, sheets)


def _find_sheets(
    arms: FloatArray, number: IntArray, spread: FloatArray, alone: FloatArray
) -> FloatArray:
    """Fit two planes to the first `number` (n,) of neighbours (n, k, 3); see `_Planes.sheets`.

    One plane has the `spread` (6, n), and leaves `alone` (n,) over.
    """
    is_held = np.arange(arms.shape[1]) < number[:, None]
    arms = arms * is_held[..., None]
    products = np.stack([arms[..., i] * arms[..., j] for i, j in _PAIRS])  # (6, n, k)
    # (n, k): along the normal of one plane; what is no neighbour is above all.
    heights = np.where(is_held, _along(arms, _least_eigenvectors(spread)), np.inf)
    is_upper = (heights > _cut_heights(heights, number)[:, None]) & is_held
    is_split = np.ones(len(arms), np.bool_)
    for _ in range(_SHEET_ROUNDS):
        sides = [_fit_side(arms, products, some) for some in (is_held & ~is_upper, is_upper)]
        is_split &= (sides[0].held >= _SHEET_LEAST) & (sides[1].held >= _SHEET_LEAST)
        is_upper = (sides[1].distances(arms) < sides[0].distances(arms)) & is_held
    # (n,): two planes take six degrees of freedom.
    squares = (sides[0].squares + sides[1].squares) / (number - 6.0)
    # The first of its neighbours is the point itself.
    normals = np.where(is_upper[:, :1], sides[1].normals, sides[0].normals)
    has_sheet = is_split & (squares < _APART * _APART * alone)
    return np.where(has_sheet[:, None], np.column_stack([normals, squares]), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """A plane through some neighbours of each point: how many, and their squares across it."""

    held: IntArray
    normals: FloatArray
    offsets: FloatArray
    squares: FloatArray

    def distances(self, arms: FloatArray) -> FloatArray:
        """Return how far each neighbour lies from the plane."""
        return np.abs(_along(arms, self.normals) - self.offsets[:, None])


def _fit_side(arms: FloatArray, products: FloatArray, some: BoolArray) -> _Side:
    held = some.sum(axis=1)
    count = np.maximum(held, 1)
    mean = (arms * some[..., None]).sum(axis=1) / count[:, None]
    spread = (products * some).sum(axis=2) / count
    for row, (i, j) in enumerate(_PAIRS):
        spread[row] -= mean[:, i] * mean[:, j]
    normals = _least_eigenvectors(spread)
    squares = np.maximum(_least_eigenvalues(spread), 0.0) * held
    return _Side(held, normals, _along(mean[:, None], normals)[:, 0], squares)


def _along(arms: FloatArray, normals: FloatArray) -> FloatArray:
    """Return how far each arm reaches along a direction."""
    x, y, z = np.moveaxis(arms * normals[:, None], 2, 0)
    reached: FloatArray = x + y + z
    return reached


def _cut_heights(heights: FloatArray, number: IntArray) -> FloatArray:
    """Return below which of some heights two groups of them are told apart best."""
    ordered = np.sort(heights, axis=1)
    lower = np.arange(1, ordered.shape[1] + 1)
    is_held = lower <= number[:, None]
    below = np.cumsum(np.where(is_held, ordered, 0.0), axis=1)
    above = below[:, -1:] - below
    # (n, k): the sum of squares between both groups, but for a constant.
    between = below * below / lower + above * above / np.maximum(number[:, None] - lower, 1)
    between[:, : _SHEET_LEAST - 1] = -1.0
    between[lower > number[:, None] - _SHEET_LEAST] = -1.0
    bounds: FloatArray = ordered[np.arange(len(ordered)), np.argmax(between, axis=1)]
    return bounds


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
    x, y, z = crosses[:, 0], crosses[:, 1], crosses[:, 2]
    lengths = x * x + y * y + z * z  # (3, n)
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
        # (n, k): its expected error, squared; see `fit_planes`.
        error = (4.0 * square / planes.held + _BIAS * beyond) / planes.extent
    best: IntArray = np.argmin(np.where(planes.extent > 0.0, error, np.inf), axis=1)
    return best


def _find_noise(squares: FloatArray, cell_of: IntArray) -> FloatArray:
    """Return the median of the residuals' squares in the cell of each point."""
    order = np.lexsort((squares, cell_of))
    ends = np.cumsum(np.bincount(cell_of))
    starts = np.append(0, ends[:-1])
    # (c,): the middle row of each cell; one past the end belongs to a cell that has no points.
    middles = np.minimum((starts + ends) // 2, len(order) - 1)
    of_cell: FloatArray = squares[order[middles]]
    return of_cell[cell_of]


def _cut(count: int) -> Iterator[slice]:
    """Cut rows into groups that fit into memory."""
    for start in range(0, count, _ROWS_AT_ONCE):
        yield slice(start, start + _ROWS_AT_ONCE)
