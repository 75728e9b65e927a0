"""The points of a tile, wherever they lie: sent with the task, or read where the cloud is.

Who may import it: the tasks of `region`, and the master that cuts the tiles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hpccomponent.surface import kernels
from hpccomponent.surface.arranged_cloud import ArrangedCloud
from hpccomponent.surface.arrangement import (
    Arrangement,
    PackedPoints,
    pack_points,
    unpack_points,
)
from hpccomponent.surface.disk_cloud import open_disk_cloud
from hpccomponent.surface.lattice import find_keys, pack_places, unique_keys, unpack_keys
from hpccomponent.surface.points import FloatArray, IntArray, PointCloud

__all__ = ["CellPoints", "pack_cloud", "read_cells", "take_points"]

CellPoints = tuple[Any, ...]
"""Points in some groups of coarse cells, as a task is given them: ``("sent", packed, ...)`` with
the arrays of a `PackedPoints` for each group; or ``("there", cloud, cells, ...)`` with the keys of
each group's cells, and a folder that the worker sees, or in this process the cloud itself."""


def take_points(
    points: CellPoints, arrangement: Arrangement, origin: FloatArray, size: float
) -> list[PointCloud]:
    """Return the points of each group, as a task has been given them.

    Parameters
    ----------
    points : CellPoints
    arrangement : Arrangement
        That they are packed by.
    origin : ndarray of float64, shape (3,)
    size : float
        Of the coarse cells, in length units of the input.

    Returns
    -------
    list of PointCloud
    """
    form, *groups = points
    if form == "sent":
        return [PointCloud(*unpack_points(arrangement, PackedPoints(*group))) for group in groups]
    cloud, *cells = groups
    if isinstance(cloud, str):
        cloud = open_disk_cloud(Path(cloud))
    return read_cells(cloud, origin, size, cells)


def read_cells(
    cloud: ArrangedCloud, origin: FloatArray, size: float, groups: list[IntArray]
) -> list[PointCloud]:
    """Return the points in some groups of coarse cells.

    Parameters
    ----------
    cloud : ArrangedCloud
    origin : ndarray of float64, shape (3,)
        Where corner (0, 0, 0) of the cells lies.
    size : float
        Of a cell, in length units of the input.
    groups : list of ndarray of int64
        Sorted keys of cells.

    Returns
    -------
    list of PointCloud
        In the cloud's order.
    """
    wanted = unique_keys(np.concatenate(groups))
    positions, normals = cloud.take_blocks(_find_blocks(cloud.arrangement, wanted, origin, size))
    if not len(positions):
        return [PointCloud(positions, normals) for _ in groups]
    cells, offsets, rows = kernels.sort_points(positions, origin, size)
    found = []
    for group in groups:
        runs = np.flatnonzero(find_keys(group, cells) < len(group))
        parts = [rows[offsets[run] : offsets[run + 1]] for run in runs.tolist()]
        chosen = np.sort(np.concatenate([rows[:0], *parts]))
        found.append(PointCloud(positions[chosen], normals[chosen]))
    return found


def pack_cloud(arrangement: Arrangement, cloud: PointCloud) -> tuple[Any, ...]:
    """Return points as they travel: the arrays of a `PackedPoints`.

    Parameters
    ----------
    arrangement : Arrangement
    cloud : PointCloud
        Arranged, with normals.
    """
    if not len(cloud):
        none = np.empty(0, np.int64)
        return none, none, *np.empty((2, 0, 3), np.float32)
    assert cloud.normals is not None  # noqa: S101 - an arranged cloud has normals
    return pack_points(arrangement, cloud.positions, cloud.normals).to_values()


def _find_blocks(
    arrangement: Arrangement, cells: IntArray, origin: FloatArray, size: float
) -> IntArray:
    """Return the blocks that overlap some cells."""
    corner = origin + size * unpack_keys(cells) - arrangement.origin
    first = np.floor(corner / arrangement.edge).astype(np.int64)
    last = np.floor((corner + size) / arrangement.edge).astype(np.int64)
    blocks = []
    for step in np.ndindex(*((last - first).max(axis=0, initial=0) + 1)):
        places = first + np.array(step)
        blocks.append(pack_places(places[(places <= last).all(axis=1)]))
    return unique_keys(np.concatenate(blocks))
