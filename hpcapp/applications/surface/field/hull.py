"""How far a surface may go where it was not seen: to the convex hull of the points.

The far field closes a wide hole by a bulge. Under an object that stood on a table there was no
room for one: wide facets of the hull, on the side that is missing, close it flat instead.

A facet over a valley is none of these. What was seen at its corners looks the other way, as a
terrain does above its hull's bottom, or a wall of a room behind it: the hull is no bound there.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.points import FloatArray

_WIDE = 4.0
"""Cells: facets that are narrower lie over points."""

_MARGIN = 1.0
"""Cells, by which the hull of their centroids is widened: rims are bare for about as much, and the
border of an open view is cut before. With .5 it curls; with .5 to 1 bare undersides are as good."""

_BARE = 0.15
"""Least length of what is missing. Evenly scanned objects have .09 and less, those that stood on a
table .21 and more; patchy ones lie between, up to .24, and their facets are judged by the rest."""

_MISSING = 0.5
"""Least cosine between a facet's normal and the way to what is missing."""

_OPPOSED = -0.25
"""Least mean cosine between a facet's normal and those of its corners: those that close objects on
tables have -.15 to .9, those under terrains and behind walls -.36 to -1."""

_TINY = 1e-300


def find_hull(
    centroids: FloatArray, normals: FloatArray, size: float, missing: FloatArray
) -> FloatArray:
    """Find planes (k, 4) that the surface of some cells of points does not leave (see `FarField`).

    `centroids` and `normals` (c, 3) are means of the points in each cell, in length units;
    `missing` (3,) is as of the cloud's `Reading`. There is no plane where nothing is missing, or
    the cells lie in a plane.
    """
    length = float(np.linalg.norm(missing))
    if length < _BARE:
        return np.empty((0, 4))
    from scipy.spatial import ConvexHull, QhullError  # takes its time

    try:
        hull = ConvexHull(centroids)
    except (QhullError, ValueError):
        return np.empty((0, 4))
    outwards, corners = hull.equations[:, :3], centroids[hull.simplices]  # (f, 3), (f, 3, 3)
    # (f,): the smallest height of each triangle.
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    areas = np.linalg.norm(cross_edges(corners), axis=1)
    is_wide = areas > _WIDE * size * sides.max(axis=1)
    is_missing = outwards @ missing > _MISSING * length
    units = normals / np.maximum(np.linalg.norm(normals, axis=1), _TINY)[:, None]
    # (f,): how far what was seen at a facet's corners looks the way that the facet does.
    cosines = (units[hull.simplices] * outwards[:, None]).sum(axis=2).mean(axis=1)
    kept = is_wide & is_missing & (cosines > _OPPOSED)
    # (k, 4): n . x = d of each, moved outwards by the margin.
    return np.column_stack([outwards[kept], _MARGIN * size - hull.equations[kept, 3]])
