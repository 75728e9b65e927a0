"""The heights of points and meshes on a lattice."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.terrain.lattice import Lattice
from hpccomponent.dataclass import dataclass

PLANE = 9.0
"""Cells that a plane is fitted to."""
_FEWEST = 4  # points of a plane: one more than it has numbers
_AWAY = 1.0  # cells between the middle and the mean of the points around that tell its slope
_AROUND = 5  # cells across which a scatter is told
_RIDGE = 1e-6  # cells squared, of a spread: points on one line have no slope across
_PAIRS = 2_000_000  # of a face and a line, that are tried at once


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """The heights of one epoch, (rows, columns) each.

    Parameters
    ----------
    values : ndarray of float64
        Means over the cells; NaN where the epoch has no support.
    variances : ndarray of float64
        Of the values, as the scatter of points tells it; zero where nothing tells it.
    planes : ndarray of float64
        The values, smoothed over three by three cells: less noise, less relief.
    cover : ndarray of float64
        The share of each cell that the epoch covers.
    is_layered : ndarray of bool
        Where there are heights that differ by more than the width of a cell: a tree, a wall.
    """

    values: FloatArray
    variances: FloatArray
    planes: FloatArray
    cover: FloatArray
    is_layered: BoolArray


def fit_heights(points: FloatArray, lattice: Lattice, cover: FloatArray) -> Heights:
    """Return the mean height of each cell: of its points, each taken along a slope to the middle.

    The slope is that of the plane through the points (n, 3) of three by three cells. Where a cell
    has none, its height is the plane's, if the mean of the points around is no farther than a cell.
    The cover is the share of each cell, (rows, columns), that the whole scan covers.
    """
    places = lattice.in_cells(points)
    cells = np.rint(places).astype(np.int64)
    column, row = cells.T
    rows, columns = lattice.shape
    is_in = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    u, v = (places[is_in] - cells[is_in]).T
    # so that sums of heights far from zero keep their digits
    middle = float(points[:, 2].mean()) if len(points) else 0.0
    z = points[is_in, 2] - middle
    keys = cells[is_in, 1] * lattice.shape[1] + cells[is_in, 0]
    terms = (np.ones_like(u), u, v, z, u * u, u * v, v * v, u * z, v * z, z * z)
    # (10, rows, columns): the moments of each cell about its own middle
    sums = [np.bincount(keys, t, lattice.count).astype(np.float64) for t in terms]
    own = np.stack(sums).reshape(-1, *lattice.shape)
    n, mu, mv, mz, uu, uv, vv, uz, vz, zz = _gather(own)
    count = np.maximum(n, 1.0)
    mu, mv, mz = mu / count, mv / count, mz / count
    uu, vv = uu / count - mu * mu + _RIDGE, vv / count - mv * mv + _RIDGE
    uv, uz, vz = uv / count - mu * mv, uz / count - mu * mz, vz / count - mv * mz
    zz = zz / count - mz * mz
    # the slopes of each plane, then its height at the middle
    spread = np.maximum(uu * vv - uv * uv, _RIDGE**2)
    along, across = (vv * uz - uv * vz) / spread, (uu * vz - uv * uz) / spread
    heights = middle + mz - along * mu - across * mv
    is_near = np.maximum(np.abs(mu), np.abs(mv)) <= _AWAY
    is_known = (n >= _FEWEST) & is_near
    scatter = np.maximum(zz - along * uz - across * vz, 0.0)
    # two layers one width apart scatter by half of it
    is_layered = is_known & (scatter > 0.25 * lattice.step**2)
    # the mean of a cell's own points, each taken along the plane to the middle, and their squares
    # about it: planes smear an edge over their neighbours, means do not
    n0, u0, v0, z0, uu0, uv0, vv0, uz0, vz0, zz0 = own
    has_own = n0 > 0
    n1 = np.maximum(n0, 1.0)
    mean = (z0 - along * u0 - across * v0) / n1
    squares = (
        zz0 - 2.0 * (along * uz0 + across * vz0)
        + along**2 * uu0 + 2.0 * along * across * uv0 + across**2 * vv0 - n0 * mean**2
    )  # fmt: skip
    squares = np.where(is_known & has_own, np.maximum(squares, 0.0), 0.0)
    freedom = np.where(is_known & has_own, n0 - 1.0, 0.0)
    noise = np.maximum(uniform_filter(squares, _AROUND), 0.0)
    noise /= np.maximum(uniform_filter(freedom, _AROUND), 1e-9)
    values = np.where(has_own, middle + mean, heights)
    return Heights(
        np.where(is_known, values, np.nan), noise / np.where(has_own, n1, count / PLANE),
        np.where(is_known, heights, np.nan), cover * is_known, is_layered,
    )  # fmt: skip


def _gather(own: FloatArray) -> FloatArray:
    """Return the moments of three by three cells about the middle of the one between."""
    rows, columns = own.shape[1:]
    padded = np.pad(own, ((0, 0), (1, 1), (1, 1)))
    total = np.zeros_like(own)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            n, u, v, z, uu, uv, vv, uz, vz, zz = padded[:, 1 + i :, 1 + j :][:, :rows, :columns]
            total += np.stack([
                n, u + j * n, v + i * n, z, uu + 2 * j * u + j * j * n,
                uv + j * v + i * u + i * j * n, vv + 2 * i * v + i * i * n,
                uz + j * z, vz + i * z, zz,
            ])  # fmt: skip
    return total


def drop_heights(mesh: Mesh, lattice: Lattice, is_solid: BoolArray | None = None) -> Heights:
    """Return the height of the highest face above the middle of each cell.

    Only the solid faces (f,) count, by default all of them.
    """
    heights = np.full(lattice.count, -np.inf)
    lowest = np.full(lattice.count, np.inf)
    kept = mesh if is_solid is None else Mesh(mesh.vertices, mesh.faces[is_solid])
    for cells, levels, _ in cross_faces(kept, lattice):
        np.maximum.at(heights, cells, levels)
        np.minimum.at(lowest, cells, levels)
    values = np.where(np.isfinite(heights), heights, np.nan).reshape(lattice.shape)
    is_layered = (heights - lowest > lattice.step).reshape(lattice.shape)
    cover = np.isfinite(values).astype(np.float64)
    # the mean over a cell is as far from its middle as a parabola's
    bends = [np.diff(values, 2, axis=k, prepend=np.nan, append=np.nan) for k in (0, 1)]
    variances = (np.nan_to_num(bends[0] + bends[1]) / 24.0) ** 2
    return Heights(values, variances, values, cover, is_layered)


def cross_faces(mesh: Mesh, lattice: Lattice) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
    """Yield where the upright lines through the middles of cells meet faces.

    That is m cells, the heights (m,), and 1 where the face looks up, -1 where down, (m,).
    """
    places = lattice.in_cells(mesh.vertices)
    corners = places[mesh.faces]  # (f, 3, 2)
    first = np.maximum(np.ceil(corners.min(axis=1)), 0.0).astype(np.int64)
    last = np.minimum(np.floor(corners.max(axis=1)), np.array(lattice.shape)[::-1] - 1.0)
    # (f, 2): the columns and rows of the box around each face
    sides = np.maximum(last.astype(np.int64) - first + 1, 0)
    counts = sides.prod(axis=1)
    rows = np.flatnonzero(counts)
    for part in np.split(rows, np.flatnonzero(np.diff(np.cumsum(counts[rows]) // _PAIRS)) + 1):
        number = counts[part]
        face = np.repeat(part, number)
        within = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
        row, column = np.divmod(within, sides[face, 0])
        line = first[face] + np.stack([column, row], axis=1)
        a, b, c = (corners[face, k] - line for k in range(3))
        # (m, 3): twice the areas opposite to the corners, signed
        areas = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
        total = areas.sum(axis=1)
        is_met = ((areas * np.sign(total)[:, None]) >= 0.0).all(axis=1) & (total != 0.0)
        face, line, areas, total = face[is_met], line[is_met], areas[is_met], total[is_met]
        levels = np.einsum("ij,ij->i", areas, mesh.vertices[mesh.faces[face], 2]) / total
        yield line[:, 1] * lattice.shape[1] + line[:, 0], levels, np.sign(total)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product
