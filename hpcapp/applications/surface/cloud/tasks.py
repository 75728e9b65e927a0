"""Tasks that measure a cloud, region by region."""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arranged import Place
from hpcapp.applications.surface.cloud.folder.disk import open_place
from hpcapp.applications.surface.cloud.patterns import (
    SampleNormals,
    SamplePositions,
    bounded_region,
    counted_boxes,
    counted_bytes,
    counted_cells,
    counted_scale,
    region_bytes,
    sampled_places,
    sampled_region,
)
from hpcapp.applications.surface.cloud.regions import RegionPoints
from hpcapp.applications.surface.cloud.spacing import sample_box_keys, sample_positions
from hpcapp.applications.surface.scale.local_scale import ScaleCounts, count_scale
from hpcapp.applications.surface.types.result_patterns import (
    SMALL_BYTES,
    CellCounts,
    CellKeys,
    Corners,
)
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import merge_counts
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.runtime.tasks import declare


@declare(result=bounded_region, limit=SMALL_BYTES)
def bound_region(points: RegionPoints) -> Corners:
    """Return the corners of the box around a region's points (a task)."""
    return np.stack(bound_points(points.take().positions))


@declare(result=counted_boxes, limit=region_bytes(16))
def count_boxes(
    points: RegionPoints, low: FloatArray, edge: float, one_in: int, is_distinct: bool
) -> tuple[int, CellKeys]:
    """Count points and boxes that hold some (a task); see `spacing.sample_box_keys`.

    If `is_distinct`, points at one place count as one.
    """
    positions = points.take().positions
    if is_distinct:
        positions = np.unique(positions, axis=0)
    return sample_box_keys(positions, low, edge, one_in)


@declare(
    result=counted_scale,
    limit=lambda points, _origin, _edge, depth: region_bytes(8 * (depth + 3))(points),
)
def count_region_scale(
    points: RegionPoints, origin: FloatArray, cell_edge: float, depth: int
) -> ScaleCounts:
    """Count a region's points in cells and smaller boxes (a task); see `count_scale`."""
    return count_scale(points.take().positions, origin, cell_edge, depth)


@declare(result=sampled_region, limit=region_bytes(48))
def sample_region(
    points: RegionPoints, low: FloatArray, edge: float, one_in: int
) -> tuple[SamplePositions, SampleNormals]:
    """Return the points in a sample of boxes (a task); see `kernels.sample_boxes`."""
    region = points.take()
    rows = kernels.sample_boxes(region.positions, low, edge, one_in)
    return region.positions[rows], region.normals[rows].astype(np.float64)


@declare(result=sampled_places, limit=region_bytes(24))
def sample_places(
    points: RegionPoints, low: FloatArray, edge: float, one_in: int
) -> SamplePositions:
    """Return where the points in a sample of boxes lie (a task); see `sample_positions`."""
    return sample_positions(points.take().positions, low, edge, one_in)


@declare(result=counted_cells, limit=counted_bytes)
def count_block_cells(
    place: Place, blocks: IntArray, origin: FloatArray, size: float
) -> tuple[CellKeys, CellCounts]:
    """Count the points of some blocks in a lattice (a task); see `ArrangedCloud.count_cells`."""
    return open_place(place).count_cells(blocks, origin, size)


def merge_cells(counted: list[tuple[IntArray, IntArray]]) -> tuple[IntArray, IntArray]:
    """Merge what `count_block_cells` has counted of several runs of blocks."""
    keys, counts = (np.concatenate(column) for column in zip(*counted, strict=True))
    return merge_counts(keys, counts)
