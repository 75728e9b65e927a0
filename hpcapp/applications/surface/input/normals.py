"""Normals for points that have none: estimated, and turned to one side over the whole object.

::

    regions ── estimate ──> normals without a side ── patches, links ──> sides ── turn ──> normals

In memory and in a folder the points come to the same normals, bit for bit: each step is a pure
function of a region's points and of a margin around it, and `orientation` sees the same patches.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpcapp.applications.surface.attributes.choice import CONFIDENCE
from hpcapp.applications.surface.input.clean_regions import cut_regions
from hpcapp.applications.surface.input.sides import Oriented
from hpcapp.applications.surface.scans import Passes
from hpccomponent.surface.cloud.arrangement import PackedPoints
from hpccomponent.surface.cloud.disk import DiskCloud, Part, write_index, write_part
from hpccomponent.surface.cloud.spacing import estimate_spacing
from hpccomponent.surface.kernels import bound_points
from hpccomponent.surface.normals import estimation, patches
from hpccomponent.surface.normals.orientation import SURE, orient_patches
from hpccomponent.surface.tasks.normals import (
    CONFIDENCE_BINS,
    Replaced,
    estimate_blocks,
    group_blocks,
    turn_blocks,
)
from hpccomponent.surface.types.lattice import find_keys
from hpccomponent.surface.types.points import BoolArray, FloatArray, IntArray, PointCloud

__all__ = [
    "orient_cloud",
    "orient_regions",
]

log = logging.getLogger("hpcapp")

_AT_ONCE = 1 << 19  # points of a region


def orient_cloud(
    cloud: PointCloud, scanners: FloatArray | None, keeps_confidence: bool = False
) -> tuple[PointCloud, Oriented]:
    """Turn the normals of points in memory to one side; estimate them where there are none.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions; arranged, or not.
    scanners : ndarray of float64, shape (s, 3), or None
        Where scanners stood, in the frame of the positions.
    keeps_confidence : bool
        Whether the points get the attribute ``confidence``, 0 to 1: how sure the side of each
        normal is. One of the file by that name stays.

    Returns
    -------
    cloud : PointCloud
        With unit normals.
    oriented : Oriented

    Raises
    ------
    InputError
        All points are the same.
    """
    positions, given = cloud.positions, cloud.normals
    spacing, (low, _) = estimate_spacing(positions), bound_points(positions)
    regions = _cut_boxes(positions, np.arange(len(positions)))
    vectors = np.empty((len(positions), 3), np.float32)
    for rows in regions:
        near, own = _find_near(positions, rows, estimation.MARGIN * spacing)
        some = estimation.estimate_normals(positions[near], own, low, spacing)
        if given is not None:
            some = estimation.keep_directions(some, given[rows])
        vectors[rows] = some
    found = []
    for rows in regions:
        near, own = _find_near(positions, rows, patches.MARGIN * spacing)
        found.append(patches.find_patches(positions[near], vectors[near], own, low, spacing))
    sides = orient_patches(*patches.merge_patches(found), spacing, -cloud.origin, scanners)
    normals, confidences = np.empty_like(positions), np.empty(len(positions), np.float32)
    is_turned = np.empty(len(positions), np.bool_)
    for rows in regions:
        near, own = _find_near(positions, rows, patches.MARGIN * spacing)
        turned = patches.turn_points(positions[near], vectors[near], low, spacing, sides)
        normals[rows], is_turned[rows], confidences[rows] = (column[own] for column in turned)
    sure = float(np.count_nonzero(confidences >= SURE)) / len(cloud)
    attributes = {CONFIDENCE: confidences, **cloud.attributes} if keeps_confidence else None
    oriented = _tell(given is not None, sure, int(np.count_nonzero(is_turned)))
    return replace(cloud, normals=normals, attributes=attributes or cloud.attributes), oriented


def _tell(is_given: bool, sure: float, turned: int) -> Oriented:
    return Oriented("file", sure, turned) if is_given else Oriented("estimated", sure)


def orient_regions(
    cloud: DiskCloud,
    keeps: bool,
    folders: tuple[Path, Path],
    passes: Passes,
    spacing: float,
    scanners: FloatArray | None,
) -> tuple[DiskCloud, Oriented]:
    """Do to a cloud in a folder what `orient_cloud` does to one in memory.

    Parameters
    ----------
    cloud : DiskCloud
    keeps : bool
        Whether its normals count, but for their side.
    folders : tuple of two Path
        Where the normals are put: at first without a side, then with one. They exist and hold no
        cloud.
    passes : Passes
        The result does not depend on it.
    spacing : float
        Of the cloud, in length units of the input.
    scanners : ndarray of float64, shape (s, 3), or None
        Where scanners stood, in the frame of the positions.

    Returns
    -------
    cloud : DiskCloud
        In the second folder.
    oriented : Oriented

    Raises
    ------
    OutputError
        The disk is full, or the folder cannot be written.
    """
    regions = cut_regions(cloud.keys, cloud.counts, passes.count_pieces(len(cloud)))
    common = cloud.low, spacing

    def tell(folder: Path, region: int) -> tuple[str, int] | None:
        return (str(folder), region) if passes.workers_see else None

    margin = estimation.MARGIN * spacing
    parts: dict[int, Part] = {}
    for region, result in passes.map_regions(
        estimate_blocks,
        cloud,
        regions,
        margin,
        None,
        lambda i: (*common, keeps, tell(folders[0], i)),
    ):
        parts[region] = _keep(result, region, folders[0])
    estimated = _write(cloud, folders[0], parts)
    margin = patches.MARGIN * spacing
    found = dict(
        passes.map_regions(group_blocks, estimated, regions, margin, None, lambda _: common)
    )
    every = [found[region] for region in range(len(regions))]
    sides = orient_patches(*patches.merge_patches(every), spacing, -cloud.origin, scanners)
    asked = [sides.take(part) for part, _ in every]
    del found, every
    counts, turned = np.zeros(CONFIDENCE_BINS, np.int64), 0
    for region, (result, opposite, binned) in passes.map_regions(
        turn_blocks,
        estimated,
        regions,
        margin,
        None,
        lambda i: (*common, asked[i], tell(folders[1], i)),
    ):
        parts[region] = _keep(result, region, folders[1])
        counts += binned
        turned += opposite
    sure = float(counts[round(SURE * CONFIDENCE_BINS) :].sum()) / len(cloud)
    return _write(cloud, folders[1], parts), _tell(keeps, sure, turned)


def _keep(result: Replaced, region: int, folder: Path) -> Part:
    """Return the part that a region has become; its points are written if no task could."""
    if isinstance(result, PackedPoints):
        result = write_part(folder, region, [result])
    return Part.whole(region, *result)


def _write(cloud: DiskCloud, folder: Path, parts: dict[int, Part]) -> DiskCloud:
    box = cloud.low, cloud.high
    written = [parts[region] for region in sorted(parts)]
    return write_index(folder, cloud.arrangement, cloud.origin, box, written)


def _cut_boxes(positions: FloatArray, rows: IntArray) -> list[IntArray]:
    """Cut points into boxes of a few each, by halving across the longest side."""
    if len(rows) <= _AT_ONCE:
        return [rows]
    low, high = bound_points(positions[rows])
    column = positions[rows, int(np.argmax(high - low))]
    is_below = column < np.median(column)
    if is_below.all() or not is_below.any():
        return [rows]
    halves = rows[is_below], rows[~is_below]
    return [box for half in halves for box in _cut_boxes(positions, half)]


def _find_near(positions: FloatArray, rows: IntArray, margin: float) -> tuple[IntArray, BoolArray]:
    """Return some points and those around them, in their order, and which are the points."""
    if len(rows) == len(positions):
        return rows, np.ones(len(rows), np.bool_)
    low, high = bound_points(positions[rows])
    columns = zip(positions.T, low - margin, high + margin, strict=True)
    is_near = np.logical_and.reduce([(column >= a) & (column <= b) for column, a, b in columns])
    near = np.flatnonzero(is_near)
    return near, find_keys(rows, near) < len(rows)
