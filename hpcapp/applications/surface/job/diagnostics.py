"""What should make a user doubt a result that came about without an error.

Each function returns sentences that say what is odd and what to do; none means no doubt.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.surface import Surface
from hpccomponent.surface import kernels
from hpccomponent.surface.kernels import bound_points
from hpccomponent.surface.types.lattice import find_first, pack_places
from hpccomponent.surface.types.points import FloatArray, IntArray, PointCloud

__all__ = ["SAMPLE", "doubt_closure", "doubt_normals", "doubt_resolution", "doubt_sides"]

#: Points are judged on a sample of about so many.
SAMPLE = 10_000
#: Fewer points than these are too far apart to be called neighbours.
FEWEST_JUDGED = 100
#: Boxes along the longest side, in which neighbouring normals are compared.
BOXES = 24
#: Mean length of the mean normals of boxes; random signs give 0.3, creases and thin sheets 0.7.
CONTRADICTING = 0.5
#: Mean of n.(x - c) / |x - c|; a sphere seen from outside has 1, from inside -1.
INWARD = -0.1
#: Share of the vertices outside the points' box; a closed scan leaves it by less than a cell.
OUTSIDE = 0.02


def doubt_normals(cloud: PointCloud) -> list[str]:
    """Doubt normals that contradict their neighbours.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions and unit normals.

    Returns
    -------
    list of str

    Notes
    -----
    Each occupied box counts once, however dense the scan is there.
    """
    _, means, counts = _average_boxes(cloud)
    dense = counts >= 8
    if not dense.any() or np.linalg.norm(means[dense], axis=1).mean() >= CONTRADICTING:
        return []
    return [
        "normals of neighbouring points contradict each other, the mesh means little: "
        "orient them consistently (e.g. in CloudCompare or MeshLab)"
    ]


def doubt_sides(cloud: PointCloud) -> list[str]:
    """Doubt normals that point into the object.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions and unit normals.

    Returns
    -------
    list of str

    Notes
    -----
    A cloud of the inside of a room is oriented like one of an object turned inside out; only
    its user can tell them apart.
    """
    centroids, means, _ = _average_boxes(cloud)
    arms = centroids - centroids.mean(axis=0) if len(centroids) else centroids
    lengths = np.linalg.norm(arms, axis=1)
    if np.einsum("ij,ij->", arms, means) >= INWARD * lengths.sum():
        return []
    return [
        "the normals seem to point into the object, and the mesh is what surrounds it: "
        "turn them around, unless this is a room seen from inside"
    ]


def _average_boxes(cloud: PointCloud) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the mean position and normal in each occupied box, and its points; of few, none."""
    if cloud.normals is None or len(cloud) < FEWEST_JUDGED:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0, np.int64)
    every = slice(None, None, -(-len(cloud) // SAMPLE))
    positions, normals = cloud.positions[every], cloud.normals[every]
    low, high = bound_points(positions)
    size = float((high - low).max()) / min(BOXES, max(1.0, np.sqrt(len(positions) / 24.0)))
    keys = pack_places(np.floor((positions - low) / size).astype(np.int64))
    order = np.argsort(keys, kind="stable")
    _, first = find_first(keys[order])
    counts = np.diff(np.append(first, len(keys)))
    means = np.add.reduceat(normals[order], first) / counts[:, None]
    return np.add.reduceat(positions[order] - low, first) / counts[:, None], means, counts


def doubt_resolution(cloud: PointCloud, step: float) -> list[str]:
    """Doubt a grid that has but a few cells for the whole cloud, as a far outlier causes it.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions.
    step : float
        Edge of a cell, in length units of the input.

    Returns
    -------
    list of str
    """
    low, high = bound_points(cloud.positions)
    along = float((high - low).max()) / step
    few = cloud.positions[:: -(-len(cloud) // SAMPLE)]  # in most clouds they tell enough
    if kernels.count_boxes(few, low, step, 1)[1] >= 2.0 * along:
        return []
    _, cells = kernels.count_boxes(cloud.positions, low, step, 1)
    if cells >= 2.0 * along or cells > len(cloud) // 4:
        return []
    return [
        f"the {len(cloud)} points lie in only {cells} cells of the grid, too few to show a shape: "
        "remove far outliers (--outliers), or choose a finer --grid"
    ]


def doubt_closure(low: FloatArray, high: FloatArray, surface: Surface, step: float) -> list[str]:
    """Doubt a mesh that leaves the box of its points: it is closed where nothing was scanned.

    Parameters
    ----------
    low, high : ndarray of float64, shape (3,)
        Corners of the box around all points, in the frame of the surface.
    surface : Surface
        With vertices.
    step : float
        Edge of a cell, in length units of the input.

    Returns
    -------
    list of str
    """
    share = surface.share_outside(low - 2.0 * step, high + 2.0 * step)
    if share <= OUTSIDE:
        return []
    return [
        f"{100.0 * share:.0f} % of the mesh lies outside the points' bounding box: the scan is "
        "open, or its normals point inwards; the mesh is closed there by guesswork"
    ]
