"""What is measured of a cloud before anything is made of it: its spacing, and a sample of it."""

from __future__ import annotations

from functools import partial

import numpy as np

from hpcapp.applications.surface.cloud.cloud_pass import CloudPass, PassT
from hpcapp.applications.surface.cloud.measured import SAMPLED_BOX, Measured, Points, draw_sample
from hpcapp.applications.surface.cloud.spacing import search_spacing
from hpcapp.applications.surface.cloud.surface_check import find_no_surface
from hpcapp.applications.surface.cloud.tasks import (
    count_boxes,
    count_region_scale,
    sample_places,
    sample_region,
)
from hpcapp.applications.surface.scale.local_scale import (
    HALVINGS,
    LocalScale,
    count_depth,
    make_scale,
)
from hpcapp.applications.surface.scale.scan_lines import GapBoxes, find_gaps
from hpcapp.geometry.lattice import lay_lattice, unique_keys
from hpcapp.geometry.points import FloatArray, PointCloud
from hpccomponent.errors import InputError


def measure_spacing(cloud_pass: CloudPass) -> float:
    """Estimate the spacing of a cloud, in length units of the input.

    Raises
    ------
    InputError
        All points are the same.
    """
    cloud = cloud_pass.cloud

    def count(edge: float, one_in: int, is_distinct: bool) -> tuple[int, int]:
        corner = lay_lattice(cloud.low, edge)
        counted = cloud_pass.each(count_boxes, corner, edge, one_in, is_distinct)
        points, keys = zip(*counted, strict=True)
        return sum(points), len(unique_keys(np.concatenate(keys)))

    return search_spacing(count, len(cloud), cloud.low, cloud.high)


def check_surface(cloud_pass: CloudPass, spacing: float) -> InputError | None:
    """Tell why a cloud's points lie on no surface; see `find_no_surface`."""
    cloud = cloud_pass.cloud

    return find_no_surface(
        partial(draw_places, cloud_pass), len(cloud), cloud.low, cloud.high, spacing
    )


def draw_places(cloud_pass: CloudPass, edge: float, one_in: int) -> FloatArray:
    """Return where the points in a sample of boxes lie, as `draw_boxes` does."""
    corner = lay_lattice(cloud_pass.cloud.low, edge)
    return np.concatenate(cloud_pass.each(sample_places, corner, edge, one_in))


def measure_scale(cloud_pass: CloudPass) -> tuple[LocalScale, GapBoxes]:
    """Find how the spacing of an arranged cloud changes from place to place, and where lines are.

    Raises
    ------
    InputError
        All points are the same.
    """
    spacing, lattice = measure_spacing(cloud_pass), cloud_pass.cloud.arrangement
    edge = lattice.edge * 2.0**-HALVINGS
    depth = count_depth(edge, spacing)
    counted = cloud_pass.each(count_region_scale, lattice.origin, edge, depth)
    scale = make_scale(spacing, lattice.origin, edge, counted)
    return scale, find_gaps(lattice.origin, edge, depth, counted)


def measure_cloud(cloud_pass: PassT, scale: LocalScale) -> PassT:
    """Keep with a cloud what methods ask of it: its scale, which is given, and a sample."""

    def draw(one_in: int) -> Points:
        return draw_boxes(cloud_pass, SAMPLED_BOX * scale.spacing, one_in)

    sample = draw_sample(draw, len(cloud_pass.cloud))
    return cloud_pass.note(Measured(scale, PointCloud(*sample)))


def draw_boxes(cloud_pass: CloudPass, edge: float, one_in: int) -> Points:
    """Return the points in a sample of boxes, in the order of the cloud.

    Parameters
    ----------
    cloud_pass : CloudPass
    edge : float
        Of a box, in length units of the input.
    one_in : int
        How many boxes make one sampled.
    """
    corner = lay_lattice(cloud_pass.cloud.low, edge)
    samples = cloud_pass.each(sample_region, corner, edge, one_in)
    positions, normals = (np.concatenate(column) for column in zip(*samples, strict=True))
    return positions, normals
