"""What is measured of a cloud before anything is made of it: its spacing, and a sample of it."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.cloud.arranged import (
    ArrangedCloud,
    CloudMeasures,
    MemoryCloud,
    Points,
    arrange_cloud,
)
from hpcapp.applications.surface.cloud.cloud_pass import CloudPass, MemoryPass, PassT
from hpcapp.applications.surface.cloud.spacing import search_spacing
from hpcapp.applications.surface.cloud.tasks import (
    count_boxes,
    count_region_scale,
    sample_places,
    sample_region,
)
from hpcapp.applications.surface.scale.local_scale import (
    HALVINGS,
    LocalScale,
    ScaleCounts,
    count_depth,
    make_scale,
)
from hpcapp.applications.surface.scale.scan_lines import GapBoxes, find_gaps
from hpcapp.applications.surface.types.reading import UNREAD, Reading
from hpcapp.geometry.lattice import lay_lattice, unique_keys
from hpcapp.geometry.points import FloatArray, PointCloud

SAMPLED_BOX = 24.0
"""Spacings: large against the cells of a probe."""

_SAMPLED_POINTS = 15_000


def measure_spacing(cloud_pass: CloudPass) -> float:
    """Estimate the spacing of a cloud; InputError where all points are the same."""
    cloud = cloud_pass.cloud

    def count(edge: float, one_in: int, is_distinct: bool) -> tuple[int, int]:
        corner = lay_lattice(cloud.low, edge)
        counted = cloud_pass.each(count_boxes, corner, edge, one_in, is_distinct)
        points, keys = zip(*counted, strict=True)
        return sum(points), len(unique_keys(np.concatenate(keys)))

    return search_spacing(count, len(cloud), cloud.low, cloud.high)


def measure_scale(cloud_pass: CloudPass, spacing: float | None = None) -> LocalScale:
    """Find how spacing changes from place to place; InputError where all points are the same.

    That of the whole cloud is measured unless it is given.
    """
    spacing = measure_spacing(cloud_pass) if spacing is None else spacing
    edge, _, counted = _count_scale(cloud_pass, spacing)
    return make_scale(spacing, cloud_pass.cloud.arrangement.origin, edge, counted)


def measure_lines(
    cloud_pass: CloudPass, spacing: float | None = None
) -> tuple[LocalScale, GapBoxes]:
    """Find what `measure_scale` does, and where scan lines are."""
    spacing = measure_spacing(cloud_pass) if spacing is None else spacing
    edge, depth, counted = _count_scale(cloud_pass, spacing)
    origin = cloud_pass.cloud.arrangement.origin
    return make_scale(spacing, origin, edge, counted), find_gaps(origin, edge, depth, counted)


def _count_scale(cloud_pass: CloudPass, spacing: float) -> tuple[float, int, list[ScaleCounts]]:
    """Return edge and halvings of the finest cells, and what is counted in them."""
    lattice = cloud_pass.cloud.arrangement
    edge = lattice.edge * 2.0**-HALVINGS
    depth = count_depth(edge, spacing)
    counted = cloud_pass.each(count_region_scale, lattice.origin, edge, depth)
    return edge, depth, counted


def find_scale(positions: FloatArray) -> LocalScale:
    """Find what `measure_scale` does, of points (n, 3) in memory."""
    return measure_scale(MemoryPass(arrange_cloud(PointCloud(positions))))


def measure_cloud(cloud_pass: PassT, scale: LocalScale, reading: Reading = UNREAD) -> PassT:
    """Keep with a cloud what methods ask of it (see `find_measures`)."""
    return cloud_pass.note(find_measures(cloud_pass, scale, reading))


def find_measures(cloud_pass: CloudPass, scale: LocalScale, reading: Reading) -> CloudMeasures:
    """Put together what methods ask of a cloud: its scale and reading, and a sample.

    The sample has about 15,000 points; of a cloud in few boxes more, and all of a small one.
    """
    one_in = first_share(len(cloud_pass.cloud))
    while True:
        sample = draw_boxes(cloud_pass, SAMPLED_BOX * scale.spacing, one_in)
        if one_in == 1 or len(sample[0]) > _SAMPLED_POINTS // 4:
            return CloudMeasures(scale, PointCloud(*sample), reading)
        one_in = max(one_in // 8, 1)


def measure_points(points: PointCloud, reading: Reading = UNREAD) -> MemoryCloud:
    """Arrange and measure points with normals in memory; InputError where all are the same."""
    cloud_pass = MemoryPass(arrange_cloud(points))
    return measure_cloud(cloud_pass, measure_scale(cloud_pass), reading).cloud


def replace_points(cloud: ArrangedCloud, points: PointCloud) -> MemoryCloud:
    """Hold other, finite points as those of a cloud are: arranged and measured, or as they are.

    InputError where all of them are the same, and would be arranged.
    """
    is_endless = np.isinf(cloud.arrangement.edge)
    return (
        MemoryCloud.as_they_are(points)
        if is_endless
        else measure_points(points, cloud.measured.reading)
    )


def first_share(points: int) -> int:
    """Return how many boxes make one sampled to begin with; of a small cloud 1: all are."""
    return max(points // _SAMPLED_POINTS, 1)


def draw_boxes(cloud_pass: CloudPass, edge: float, one_in: int) -> Points:
    """Return the points in a sample of boxes, one of `one_in`, in the order of the cloud."""
    corner = lay_lattice(cloud_pass.cloud.low, edge)
    samples = cloud_pass.each(sample_region, corner, edge, one_in)
    positions, normals = (np.concatenate(column) for column in zip(*samples, strict=True))
    return positions, normals


def draw_places(cloud_pass: CloudPass, edge: float, one_in: int) -> FloatArray:
    """Return where the points in a sample of boxes lie, as `draw_boxes` does."""
    corner = lay_lattice(cloud_pass.cloud.low, edge)
    return np.concatenate(cloud_pass.each(sample_places, corner, edge, one_in))
