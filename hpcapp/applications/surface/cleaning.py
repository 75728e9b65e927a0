"""What is done to every cloud before it is fitted: sorted, outliers out, normals turned round.

Who may import it: the job and the methods of this package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface import kernels
from hpccomponent.surface.normals import mend_normals
from hpccomponent.surface.outliers import find_outliers
from hpccomponent.surface.points import FloatArray, PointCloud, bounding_box
from hpccomponent.surface.spacing import estimate_spacing

__all__ = ["Cleaned", "arrange_points", "clean_cloud"]

_BLOCKS = 64  # along the longest side, in each of which the points stay in their order
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
        Finite positions.

    Returns
    -------
    PointCloud
        The same points, block by block; within a block in their order.

    Notes
    -----
    All that follows goes through the cloud by cells. In the order of a file, which may be any,
    each point would have to come from the far end of memory, again and again.
    """
    low, high = bounding_box(cloud.positions)
    edge = float((high - low).max()) / _BLOCKS
    if not edge > 0.0:
        return cloud
    return cloud.take(kernels.sort_points(cloud.positions, low, edge)[2])


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
    Points farther from the middle of the cloud than a hundred times its core are dropped first:
    a scanner's marker for "no echo" may lie where no lattice of the cloud's spacing reaches.
    See `find_outliers` and `mend_normals` for the rest.
    """
    if not len(cloud):
        return cloud, Cleaned(0, 0)
    near = _find_near(cloud.positions)
    kept = cloud if near.all() else cloud.take(near)
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
