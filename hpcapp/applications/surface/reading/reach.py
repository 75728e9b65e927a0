"""How far from the middle of a cloud its points may lie, told by an even sample of them."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.validity import Reach

_SAMPLE = 20_000
_CORE = (0.02, 0.98)  # quantiles of each coordinate
_CORES = 100.0  # longest sides of the core: beyond them lie markers, not measurements


def drop_far(cloud: PointCloud) -> PointCloud:
    """Drop points farther from the middle of a cloud than a hundred times its core.

    A scanner's marker for "no echo" may lie where no lattice of the cloud's spacing reaches.
    Positions are finite, and keep their order; the input itself is returned where none lies so far.
    """
    if not len(cloud):
        return cloud
    sample = EvenSample()
    sample.add(cloud.positions)
    reach = find_reach(sample.positions)
    if reach.holds(*bound_points(cloud.positions)):
        return cloud
    return cloud.take(reach.find_near(cloud.positions))


def even_step(points: int) -> int:
    """Return the power of two of which every so many-th point of a cloud is in an even sample.

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
        """Take the next points of the cloud, of shape (n, 3), in its order."""
        step = even_step(self._seen + len(positions))
        self._positions, self._step = self._positions[:: step // self._step], step
        taken = positions[-self._seen % self._step :: self._step]
        self._positions = np.concatenate([self._positions, taken])
        self._seen += len(positions)


def find_reach(sample: FloatArray) -> Reach:
    """Find how far from the middle of a cloud points may lie: a hundred times its core.

    The sample (s, 3) is that of an `EvenSample`, of at least one point.
    """
    low, high = np.sort(sample, axis=0)[np.rint(np.multiply(_CORE, len(sample) - 1)).astype(int)]
    distance = _CORES * float((high - low).max())
    return Reach(0.5 * (low + high), distance if distance > 0.0 else np.inf)
