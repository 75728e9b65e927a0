"""Depth images whose layers lie far apart are smoothed as they are read, wherever they are put."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from hpcapp.applications.surface.scale.depth_image import MOST, smooth_steps
from hpcapp.geometry.points import PointCloud
from hpcapp.geometry.validity import are_finite
from hpcapp.io import PointSource
from hpcapp.io.batches import cut_points, join_points

_ROWS = 1 << 18  # at once


def smooth_cloud(cloud: PointCloud) -> tuple[PointCloud, int]:
    """Return a cloud after `smooth_steps`, and how many points may have moved."""
    if cloud.normals is not None or cloud.origin.any():  # an image is not far from its camera
        return cloud, 0
    is_finite = are_finite(cloud.positions)
    smoothed, moved = smooth_steps(cloud.positions[is_finite])
    if not moved:
        return cloud, 0
    positions = cloud.positions.copy()
    positions[is_finite] = smoothed
    return replace(cloud, positions=positions), moved


def smooth_source(source: PointSource) -> tuple[PointSource, int]:
    """Return the same of a file; more points than an image has are not read."""
    if source.has_normals:
        return source, 0
    parts, count = [], 0
    for part in source.chunks(_ROWS):
        parts.append(part)
        count += int(np.count_nonzero(are_finite(part.positions)))
        if count > MOST:
            return source, 0
    whole, moved = smooth_cloud(join_points(parts))
    if not moved:
        return source, 0
    scan = partial(cut_points, whole)
    return replace(source, scan=scan, records=None, check_rest=None, octree=None), moved
