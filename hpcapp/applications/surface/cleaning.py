"""What is done to every cloud before it is fitted: sorted, outliers out, normals turned round.

Who may import it: the job and the methods of this package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface import kernels
from hpccomponent.surface.arrangement import choose_arrangement, snap_points
from hpccomponent.surface.normals import mend_normals
from hpccomponent.surface.outliers import find_outliers
from hpccomponent.surface.points import FloatArray, PointCloud, bounding_box
from hpccomponent.surface.spacing import estimate_spacing

__all__ = ["Cleaned", "arrange_points", "clean_cloud", "drop_far"]

_SAMPLE = 10_000
_CORE = (0.02, 0.98)  # quantiles of each coordinate
_CORES = 100.0  # longest sides of the core: beyond them lie markers, not measurements


@dataclass(frozen=True, slots=True)
class Cleaned:
    """What was found wrong with a cloud.

    Parameters
    ----------
    outliers : int
        Points that were dropped.
    flipped : int
        Normals that were turned round.
    """

    outliers: int
    flipped: int


def arrange_points(cloud: PointCloud) -> PointCloud:
    """Bring points that are near each other in space near each other in memory.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions; markers far away must have been dropped (see `drop_far`), for the
        longest side decides how the rest is rounded.

    Returns
    -------
    PointCloud
        The same points, rounded and sorted as `arrangement` says; within a block in their order.

    Notes
    -----
    All that follows goes through the cloud by cells. In the order of a file, which may be any,
    each point would have to come from the far end of memory, again and again. Rounded to a
    billionth of the longest side, points are the same in memory, on disk and on the wire.
    """
    low, high = bounding_box(cloud.positions)
    if (low == high).all():
        return cloud
    arrangement = choose_arrangement(low, high)
    snapped = snap_points(arrangement, cloud.positions)
    normals = None if cloud.normals is None else cloud.normals.astype(np.float32)
    rows = kernels.sort_points(snapped, arrangement.origin, arrangement.edge)[2]
    return PointCloud(
        snapped[rows],
        None if normals is None else normals[rows].astype(np.float64),
        None if cloud.colors is None else cloud.colors[rows],
        cloud.origin,
    )


def drop_far(cloud: PointCloud) -> PointCloud:
    """Drop points farther from the middle of a cloud than a hundred times its core.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions.

    Returns
    -------
    PointCloud
        In their order; the input itself where none lies so far.

    Notes
    -----
    A scanner's marker for "no echo" may lie where no lattice of the cloud's spacing reaches.
    """
    if not len(cloud):
        return cloud
    near = _find_near(cloud.positions)
    return cloud if near.all() else cloud.take(near)


def clean_cloud(cloud: PointCloud, threads: int = 1) -> tuple[PointCloud, Cleaned]:
    """Drop the points that belong to no surface and turn round the normals that point inwards.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions; unit normals, or none.
    threads : int
        The result does not depend on it.

    Returns
    -------
    cloud : PointCloud
        The points that remain, in their order; the input itself where nothing is wrong.
    cleaned : Cleaned

    Raises
    ------
    InputError
        All points are the same.

    Notes
    -----
    See `drop_far`, `find_outliers` and `mend_normals`.
    """
    if not len(cloud):
        return cloud, Cleaned(0, 0)
    kept = drop_far(cloud)
    spacing = estimate_spacing(kept.positions)
    strays = find_outliers(kept.positions, spacing)
    if strays.any():
        kept = kept.take(~strays)
        spacing = estimate_spacing(kept.positions)
    flipped = 0
    if kept.normals is not None:
        normals, flipped = mend_normals(kept.positions, kept.normals, spacing, threads)
        if flipped:
            kept = PointCloud(kept.positions, normals, kept.colors, kept.origin)
    return kept, Cleaned(len(cloud) - len(kept), flipped)


def _find_near(positions: FloatArray) -> NDArray[np.bool_]:
    """Tell which points lie within reach of the core, judged by every so many-th point."""
    sample = positions[:: len(positions) // _SAMPLE + 1]
    low, high = np.sort(sample, axis=0)[np.rint(np.multiply(_CORE, len(sample) - 1)).astype(int)]
    reach = _CORES * float((high - low).max())
    if reach <= 0.0:
        return np.ones(len(positions), np.bool_)
    middle = 0.5 * (low + high)
    if (np.abs(np.stack(bounding_box(positions)) - middle) <= reach).all():
        return np.ones(len(positions), np.bool_)
    away = np.abs(positions - middle)
    near: NDArray[np.bool_] = (away <= reach).all(axis=1)
    return near
