"""What is done to every cloud before it is fitted: sorted, outliers out, normals turned round."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hpccomponent.surface.cloud.arranged import MemoryCloud
from hpccomponent.surface.cloud.outliers import find_outliers
from hpccomponent.surface.cloud.repeated import find_repeated
from hpccomponent.surface.cloud.spacing import estimate_spacing
from hpccomponent.surface.cloud.validity import Reach
from hpccomponent.surface.kernels import bound_points
from hpccomponent.surface.normals.consistency import mend_normals
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = [
    "Cleaned",
    "EvenSample",
    "clean_cloud",
    "drop_far",
    "drop_repeated",
    "even_step",
    "find_reach",
]

_SAMPLE = 20_000
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
    repeated : int
        Points at the place of another that were dropped.
    """

    outliers: int
    flipped: int
    repeated: int = 0


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
    sample = EvenSample()
    sample.add(cloud.positions)
    reach = find_reach(sample.positions)
    if reach.holds(*bound_points(cloud.positions)):
        return cloud
    return cloud.take(reach.find_near(cloud.positions))


def drop_repeated(cloud: MemoryCloud) -> MemoryCloud:
    """Drop the points of a cloud that are at the place of another.

    Parameters
    ----------
    cloud : MemoryCloud

    Returns
    -------
    MemoryCloud
        The first point of each place, in their order; the input itself where there are no others.
    """
    repeated = find_repeated(cloud.points.positions)
    return cloud.select(~repeated) if repeated.any() else cloud


def even_step(points: int) -> int:
    """Return the power of two of which every so many-th point of a cloud is in an even sample.

    Parameters
    ----------
    points : int
        Of the cloud.

    Returns
    -------
    int
        1 where all points are in the sample.
    """
    step = 1
    while points > _SAMPLE * step:
        step *= 2
    return step


class EvenSample:
    """Every so many-th point of a cloud, of which there may be more to come.

    The step is the power of two that leaves at most `_SAMPLE` points, so that it is the same
    whether the cloud comes as a whole or in parts.
    """

    def __init__(self) -> None:
        self._positions = np.zeros((0, 3))
        self._step = 1
        self._seen = 0

    @property
    def positions(self) -> FloatArray:
        """Shape (s, 3), in length units of the input; at most `_SAMPLE`."""
        return self._positions

    def add(self, positions: FloatArray) -> None:
        """Take the next points of the cloud, of shape (n, 3).

        Parameters
        ----------
        positions : ndarray of float64, shape (n, 3)
            In length units of the input, in the order of the cloud.
        """
        step = even_step(self._seen + len(positions))
        self._positions, self._step = self._positions[:: step // self._step], step
        taken = positions[-self._seen % self._step :: self._step]
        self._positions = np.concatenate([self._positions, taken])
        self._seen += len(positions)


def find_reach(sample: FloatArray) -> Reach:
    """Find how far from the middle of a cloud points may lie: a hundred times its core.

    Parameters
    ----------
    sample : ndarray of float64, shape (s, 3)
        See `EvenSample`; at least one point.

    Returns
    -------
    Reach
    """
    low, high = np.sort(sample, axis=0)[np.rint(np.multiply(_CORE, len(sample) - 1)).astype(int)]
    distance = _CORES * float((high - low).max())
    return Reach(0.5 * (low + high), distance if distance > 0.0 else np.inf)


def clean_cloud(cloud: MemoryCloud, threads: int = 1) -> tuple[MemoryCloud, Cleaned]:
    """Drop the points that belong to no surface and turn round the normals that point inwards.

    Parameters
    ----------
    cloud : MemoryCloud
        Finite positions; unit normals, or none.
    threads : int
        The result does not depend on it.

    Returns
    -------
    cloud : MemoryCloud
        The points that remain, in their order; the input itself where nothing is wrong.
    cleaned : Cleaned

    Raises
    ------
    InputError
        All points are the same.

    Notes
    -----
    Far points must have been dropped (see `drop_far`). See `find_outliers` and `mend_normals`
    for the rest; `clean_regions` does the same to a cloud that is not in memory.
    """
    kept, positions = cloud, cloud.points.positions
    spacing = estimate_spacing(positions)
    strays = find_outliers(positions, spacing)
    if strays.any():
        kept = cloud.select(~strays)
        positions = kept.points.positions
        spacing = estimate_spacing(positions)
    flipped = 0
    if kept.points.normals is not None:
        normals, flipped = mend_normals(positions, kept.points.normals, spacing, threads)
        if flipped:
            kept = replace(kept, points=replace(kept.points, normals=normals))
    return kept, Cleaned(len(cloud) - len(kept), flipped)
