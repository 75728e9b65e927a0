"""Tasks that look at the points of an arranged cloud once, block after block."""

from __future__ import annotations

import numpy as np

from hpccomponent.runtime.tasks import declare
from hpccomponent.surface import kernels
from hpccomponent.surface.cloud.arranged import Place
from hpccomponent.surface.cloud.disk import open_place
from hpccomponent.surface.cloud.measured import Points
from hpccomponent.surface.cloud.regions import DroppedCells, Region, take_region
from hpccomponent.surface.cloud.spacing import sample_box_keys
from hpccomponent.surface.tasks.cloud_patterns import (
    counted_boxes,
    counted_cells,
    region_bytes,
    run_bytes,
    sampled_blocks,
    surveyed_blocks,
)
from hpccomponent.surface.tasks.file_ranges import BoxCounts
from hpccomponent.surface.tasks.result_patterns import SMALL_BYTES
from hpccomponent.surface.types.lattice import merge_counts
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = [
    "BlockPoints",
    "count_block_boxes",
    "count_block_cells",
    "merge_cells",
    "sample_blocks",
    "survey_blocks",
]

BlockPoints = tuple[str, IntArray, DroppedCells | None]
"""The folder of a `DiskCloud` that the worker sees, the sorted keys of blocks, `DroppedCells`."""


@declare(result=surveyed_blocks, limit=SMALL_BYTES)
def survey_blocks(points: BlockPoints) -> tuple[int, FloatArray]:
    """Count and bound the points in some blocks (a task).

    Parameters
    ----------
    points : tuple
        `BlockPoints`.

    Returns
    -------
    count : int
    box : ndarray of float64, shape (2, 3)
    """
    positions = _take(points).positions
    if not len(positions):
        return 0, np.array([[np.inf] * 3, [-np.inf] * 3])
    return len(positions), np.stack(kernels.bound_points(positions))


@declare(result=counted_boxes, limit=region_bytes(16))
def count_block_boxes(
    points: BlockPoints, low: FloatArray, edges: tuple[float, ...], one_in: int, is_distinct: bool
) -> BoxCounts:
    """Count points and boxes that hold some (a task); see `spacing.sample_box_keys`.

    Parameters
    ----------
    points : tuple
        `BlockPoints`.
    low : ndarray of float64, shape (3,)
        The least coordinates of the cloud.
    edges : tuple of float
        Of the boxes, in length units of the input.
    one_in : int
        How many boxes make one sampled.
    is_distinct : bool
        Whether points at one place count as one.

    Returns
    -------
    BoxCounts
        For each edge.
    """
    positions = _take(points).positions
    if is_distinct and len(positions):
        positions = np.unique(positions, axis=0)
    return [sample_box_keys(positions, low, edge, one_in) for edge in edges]


@declare(result=sampled_blocks, limit=region_bytes(48))
def sample_blocks(points: BlockPoints, low: FloatArray, edge: float, one_in: int) -> Points:
    """Return the points in a sample of boxes (a task); see `kernels.sample_boxes`.

    Parameters
    ----------
    points : tuple
        `BlockPoints`.
    low, edge, one_in
        As for `kernels.sample_boxes`.

    Returns
    -------
    positions, normals : ndarray of float64, shape (s, 3)
    """
    region = _take(points)
    positions = region.positions
    if not len(positions):
        return positions, positions
    rows = kernels.sample_boxes(positions, low, edge, one_in)
    normals = region.packed.normals.take(region.rows[rows], axis=0)
    return positions[rows], normals.astype(np.float64)


@declare(result=counted_cells, limit=run_bytes(16))
def count_block_cells(
    place: Place, blocks: IntArray, origin: FloatArray, size: float
) -> tuple[IntArray, IntArray]:
    """Count the points in each occupied cell of a lattice (a task).

    Parameters
    ----------
    place : Place
        Of the cloud.
    blocks : ndarray of int64, shape (k,)
        Sorted keys of some of its blocks.
    origin : ndarray of float64, shape (3,)
        Corner of a cell.
    size : float
        Of a cell, in length units of the input.

    Returns
    -------
    keys, counts : ndarray of int64, shape (c,)
        Sorted by key.
    """
    return open_place(place).count_cells(blocks, origin, size)


def merge_cells(counted: list[tuple[IntArray, IntArray]]) -> tuple[IntArray, IntArray]:
    """Merge what was counted of several runs of blocks.

    Parameters
    ----------
    counted : list of tuple
        Keys and counts of each run, as `count_block_cells` returns them.

    Returns
    -------
    keys, counts : ndarray of int64, shape (c,)
        Sorted by key.
    """
    keys, counts = (np.concatenate(column) for column in zip(*counted, strict=True))
    return merge_counts(keys, counts)


def _take(points: BlockPoints) -> Region:
    folder, blocks, dropped = points
    return take_region((folder, blocks, 0.0, dropped))
