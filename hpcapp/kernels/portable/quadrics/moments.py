"""Moments of the points in a cell: all that a fit needs to know of them.

A row of moments holds, about one centre and in units of one cell,

====== ================================================================================
0..34  the sums of x^a y^b z^c over the points, a + b + c <= 4, in the order `EXPONENTS`
35..43 sum of n . grad phi_i for the nine basis functions x, y, z, xx, yy, zz, xy, yz, zx
====== ================================================================================

Rows add, may be moved to another centre and scaled to another unit, each exactly. Sums run in
the order of the points, so that a row does not depend on the batch that it was computed in.
"""

from __future__ import annotations

from math import comb

import numpy as np

from hpcapp.geometry.lattice import OCTANTS, find_keys, pack_places, unique_keys, unpack_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels.constants import COLUMNS

__all__ = ["accumulate_moments", "merge_cells"]

Exponent = tuple[int, int, int]


def _ordered_exponents() -> tuple[Exponent, ...]:
    """Return the exponents of degree 0 to 4, the ten basis functions of a quadric first."""
    basis: list[Exponent] = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (0, 2, 0)]
    basis += [(0, 0, 2), (1, 1, 0), (0, 1, 1), (1, 0, 1)]
    higher = [
        (a, b, degree - a - b)
        for degree in (3, 4)
        for a in range(degree, -1, -1)
        for b in range(degree - a, -1, -1)
    ]
    return (*basis, *higher)


EXPONENTS = _ordered_exponents()
_COLUMN_OF = {exponent: column for column, exponent in enumerate(EXPONENTS)}
_CHUNK_POINTS = 1 << 14
_CHUNK_ROWS = 1 << 12


def _lowered(exponent: Exponent, axis: int, by: int = 1) -> Exponent:
    """Return the exponent with one coordinate's power reduced."""
    a, b, c = (power - by * (axis == other) for other, power in enumerate(exponent))
    return a, b, c


def _build_steps() -> tuple[tuple[int, int], ...]:
    """Return, for each monomial but the first, (an earlier monomial, the axis to multiply by)."""
    steps = []
    for exponent in EXPONENTS[1:]:
        axis = next(axis for axis in range(3) if exponent[axis])
        steps.append((_COLUMN_OF[_lowered(exponent, axis)], axis))
    return tuple(steps)


def _shift_steps(axis: int) -> tuple[tuple[int, tuple[tuple[int, int, int], ...]], ...]:
    """Return (column, its (source column, binomial, power of the shift)) for one axis.

    Columns of high power come first: each reads only columns that are not shifted yet.
    """
    steps = []
    for exponent in sorted(EXPONENTS, key=lambda e: -e[axis]):
        power = exponent[axis]
        terms = tuple(
            (_COLUMN_OF[_lowered(exponent, axis, by)], comb(power, by), by)
            for by in range(1, power + 1)
        )
        if terms:
            steps.append((_COLUMN_OF[exponent], terms))
    return tuple(steps)


_PRODUCTS = _build_steps()
_SHIFTS = tuple(_shift_steps(axis) for axis in range(3))
# (column, source, axis of the shift, factor): grad of a second-degree basis function, shifted.
_NORMAL_SHIFTS = (
    (38, 35, 0, 2),
    (39, 36, 1, 2),
    (40, 37, 2, 2),
    (41, 35, 1, 1),
    (41, 36, 0, 1),
    (42, 36, 2, 1),
    (42, 37, 1, 1),
    (43, 35, 2, 1),
    (43, 37, 0, 1),
)


def accumulate_moments(
    local_positions: FloatArray,
    normals: FloatArray,
    offsets: IntArray,
    weights: FloatArray | None = None,
    threads: int = 1,
) -> FloatArray:
    """Sum the moments of the points of each cell, (c, 44), in the order of the module's table.

    Positions (n, 3) are relative to the centre of the point's cell, in cells, and sorted by cell:
    by `offsets` (c + 1,), cell i holds the points offsets[i] to offsets[i + 1]. Normals (n, 3) have
    unit length, and point out of the object. `weights` (n,), by default 1, are what points count.

    Notes
    -----
    A monomial is the product of an earlier one and one coordinate; each sum starts at zero and
    runs in the order of the points.
    """
    del threads  # numpy runs on one
    cells = len(offsets) - 1
    moments = np.empty((cells, COLUMNS))
    start = 0
    while start < cells:
        # As many whole cells as hold a chunk of points, one at least.
        limit = offsets[start] + _CHUNK_POINTS
        stop = max(start + 1, int(np.searchsorted(offsets, limit, side="right")) - 1)
        stop = min(stop, cells)
        points = slice(int(offsets[start]), int(offsets[stop]))
        # (n,): the cell of each point, counted from the first of the chunk.
        owners = np.repeat(np.arange(stop - start), np.diff(offsets[start : stop + 1]))
        moments[start:stop] = _sum_chunk(
            local_positions[points],
            normals[points],
            np.ones(len(owners)) if weights is None else weights[points],
            owners,
            stop - start,
        )
        start = stop
    return moments


def _sum_chunk(
    positions: FloatArray, normals: FloatArray, weights: FloatArray, owners: IntArray, cells: int
) -> FloatArray:
    """Sum the moments of some cells, points of cell i marked with owner i."""
    coordinates = np.ascontiguousarray(positions.T)  # (3, n): one contiguous row for each axis
    x, y, z = coordinates
    nx, ny, nz = weights * np.ascontiguousarray(normals.T)
    # 35 of (n,): the monomials of each point, of which the first is 1 times its weight.
    columns = [weights]
    for source, axis in _PRODUCTS:
        columns.append(columns[source] * coordinates[axis])
    # 9 more: n . grad phi for x, y, z; xx, yy, zz; and xy, yz, zx.
    columns += [nx, ny, nz, 2.0 * x * nx, 2.0 * y * ny, 2.0 * z * nz]
    columns += [y * nx + x * ny, z * ny + y * nz, z * nx + x * nz]
    # bincount adds one point after the other; reduceat would add pairwise.
    return np.stack([np.bincount(owners, column, cells) for column in columns], axis=1)


def shift_moments(moments: FloatArray, shift: FloatArray) -> FloatArray:
    """Move moments (c, 44) to another centre, by binomials, one axis after the other: x, y, z.

    `shift` (3,) is the old centre seen from the new one, in cells: it is added to every point.
    """
    shifted = np.empty_like(moments)
    for start in range(0, len(moments), _CHUNK_ROWS):
        # A copy even where a single row is contiguous both ways: it is shifted in place.
        columns = np.array(moments[start : start + _CHUNK_ROWS].T, order="C")
        _shift_columns(columns, [float(step) for step in shift])
        shifted[start : start + _CHUNK_ROWS] = columns.T
    return shifted


def _shift_columns(columns: FloatArray, shift: list[float]) -> None:
    """Shift moments, one column each, in place."""
    for axis, step in enumerate(shift):
        for column, terms in _SHIFTS[axis]:
            for source, binomial, power in terms:
                columns[column] += (binomial * step**power) * columns[source]
    for column, source, axis, factor in _NORMAL_SHIFTS:
        columns[column] += (factor * shift[axis]) * columns[source]


def scale_moments(moments: FloatArray) -> FloatArray:
    """Express moments (c, 44) in cells of twice the size."""
    degrees = [sum(exponent) for exponent in EXPONENTS] + [0, 0, 0, 1, 1, 1, 1, 1, 1]
    return moments * 0.5 ** np.array(degrees, dtype=np.float64)


def merge_cells(cells: IntArray, moments: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sum the moments (c, 44) of each eight children about the centre of their parent.

    Given sorted keys (c,), return those of the next coarser level (p,), and moments (p, 44) in
    units of the parents.
    """
    places = unpack_keys(cells)
    keys = pack_places(places >> 1)
    parents = unique_keys(keys)
    owners = find_keys(parents, keys)  # (c,): the row of each cell's parent
    which = (places & 1) @ np.array([1, 2, 4])  # (c,): which octant of it, x fastest
    merged = np.zeros((len(parents), COLUMNS))
    for child, octant in enumerate(OCTANTS):
        chosen = which == child
        # A parent has one child of each octant at most: no row is named twice.
        merged[owners[chosen]] += shift_moments(moments[chosen], octant - 0.5)
    return parents, scale_moments(merged)
