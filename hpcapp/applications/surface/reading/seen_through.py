"""Points of one scan through which another scan has looked: ghosts of what moved, and reflections.

::

    points of each scan ──> how far away it saw something, in bins of directions
    a point of another scan, nearer than all of that around its direction ──> was not there
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.reading.reach import EvenSample
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray, PointCloud
from hpcapp.geometry.validity import are_finite
from hpcapp.io import PointSource
from hpcapp.io.batches import batch_points
from hpcapp.io.points.point_source import SCAN
from hpccomponent.dataclass import dataclass

SEEN_THROUGH = "seen through by another scan"
"""Why points are left out of a file of several scans."""

_PER_BIN = 4.0  # points of a scan that has as many in every direction
_FINEST = 1 << 10  # bins from pole to pole, at most
_BEYOND = 5.0
"""Bins across: so much farther away, at the point, is what was seen behind it. Of somebody who
stood in one of three scans of a room 82 to 98 % go with 1 bin, 78 to 96 % with 5 and 73 to 94 %
with 10, by the number of points; of a town, a room and a heap nothing. Where a room's noise is
3 cm, .07, .01 and .006 % of it go; where its scans do not fit by 10 cm, 2.8, 1.2 and .4 %."""
_MOST = 0.3  # of the points of a scan: where more are seen through, scans stood elsewhere
_ASKED = 4  # scans, the nearest to a point; of 50 that takes 2.6 microseconds, and 15 to ask all
_ROWS = 1 << 20  # at once
_UNTOLD = 1 << 20  # points of a file that does not say how many there are


@dataclass(slots=True, eq=False)
class DepthSphere:
    """How far away a scanner saw something, in bins of directions.

    `nearest`, (h, 2 h), has elevations from the lower pole, and azimuths; infinity where nothing
    was seen. After `around` it is the least of nine bins, 0 where nothing was seen in one.
    """

    place: FloatArray
    nearest: Float32Array

    @classmethod
    def empty(cls, place: FloatArray, points: int) -> DepthSphere:
        """Return one whose bins suit so many points."""
        width = np.sqrt(4.0 * np.pi * _PER_BIN / max(points, 1))
        height = int(np.clip(np.pi / width, 8, _FINEST))
        return cls(place, np.full((height, 2 * height), np.inf, np.float32))

    def add(self, positions: FloatArray) -> None:
        """Add what it saw, (n, 3), before `around`."""
        distances, bins = self._find(positions)
        np.minimum.at(self.nearest.reshape(-1), bins, distances.astype(np.float32))

    def around(self) -> DepthSphere:
        """Return the least of each bin and the eight around it."""
        seen = np.where(np.isinf(self.nearest), np.float32(0.0), self.nearest)
        # (h + 2, 2 h + 2): azimuths go on around, and beyond the poles nothing was seen.
        padded = np.pad(np.pad(seen, ((0, 0), (1, 1)), "wrap"), ((1, 1), (0, 0)))
        windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
        return replace(self, nearest=windows.min(axis=(2, 3)))

    def looks_through(self, positions: FloatArray) -> BoolArray:
        """Tell which points, (n, 3), it would have had to see."""
        distances, bins = self._find(positions)
        beyond = 1.0 + _BEYOND * np.pi / len(self.nearest)
        through: BoolArray = self.nearest.reshape(-1)[bins] > beyond * distances
        return through

    def _find(self, positions: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return how far away points are, and in which bins."""
        height, width = self.nearest.shape
        rays = positions - self.place
        distances: FloatArray = np.sqrt(np.einsum("ni,ni->n", rays, rays))
        heights = rays[:, 2] / np.maximum(distances, 1e-300)
        elevations = np.arcsin(np.clip(heights, -1.0, 1.0)) / np.pi + 0.5
        azimuths = np.arctan2(rays[:, 1], rays[:, 0]) / (2.0 * np.pi) + 0.5
        row = np.minimum((elevations * height).astype(np.int64), height - 1)
        return distances, row * width + np.minimum((azimuths * width).astype(np.int64), width - 1)


def drop_seen_through(source: PointSource) -> PointSource:
    """Return the points of a file without those that another of its scans has seen through.

    Where a file tells no scans apart, or not where each stood, it is the same. It is read twice.
    """
    around = look_around(source)
    if not around:
        return source

    def scan(rows: int) -> Iterator[PointCloud]:
        source.findings.dropped.pop(SEEN_THROUGH, None)  # they are counted anew
        return batch_points(_keep(source, around, max(rows, _ROWS)), rows)

    return replace(source, scan=scan, records=None, check_rest=None, octree=None)


def look_around(source: PointSource) -> list[DepthSphere]:
    """Return what each scan of a file saw; nothing where it does not tell, or tells it wrongly."""
    places = [one.scanner for one in source.scans if one.scanner is not None]
    if len(places) < 2 or len(places) != len(source.scans):
        return []
    # Where a file says of none how many points it has, each has as many.
    share = (source.count or _UNTOLD) // len(places)
    spheres = [
        DepthSphere.empty(place, one.points or share)
        for place, one in zip(places, source.scans, strict=True)
    ]
    samples = [EvenSample() for _ in places]
    for part in source.chunks(_ROWS):
        numbers, is_finite = part.attributes.get(SCAN), are_finite(part.positions)
        if numbers is None:
            return []
        for number, (sphere, sample) in enumerate(zip(spheres, samples, strict=True)):
            positions = part.positions[is_finite & (numbers == number)]
            sphere.add(positions)
            sample.add(positions)
    around = [sphere.around() for sphere in spheres]
    for number, sample in enumerate(samples):
        numbers = np.full(len(sample.positions), number)
        if np.count_nonzero(_look(sample.positions, numbers, around)) > _MOST * len(numbers):
            return []
    return around


def are_seen_through(cloud: PointCloud, around: Sequence[DepthSphere]) -> BoolArray:
    """Tell which points of a file, (n,), another one of its scans has seen through."""
    if not around:
        return np.zeros(len(cloud), np.bool_)
    return _look(cloud.positions, cloud.attributes[SCAN], around)


def _keep(source: PointSource, around: Sequence[DepthSphere], rows: int) -> Iterator[PointCloud]:
    for part in source.scan(rows):
        through = are_seen_through(part, around)
        source.findings.drop(SEEN_THROUGH, int(np.count_nonzero(through)))
        yield part.take(np.flatnonzero(~through))


def _look(positions: FloatArray, numbers: NDArray[Any], around: Sequence[DepthSphere]) -> BoolArray:
    """Tell which points, of scans of some numbers, a scan that stood near has seen through.

    Only so many are asked: what is asked of a point does not grow with the number of scans.
    """
    rows, through = np.flatnonzero(are_finite(positions)), np.zeros(len(positions), np.bool_)
    asked = min(_ASKED, len(around))
    places = np.stack([sphere.place for sphere in around])
    nearest = _find_nearest(places, positions[rows], asked)
    # (n * asked,): pairs of a point and a scan, by scan.
    order = np.argsort(nearest, axis=None, kind="stable")
    ends = np.cumsum(np.bincount(nearest.reshape(-1), minlength=len(around)))
    for number, (start, end) in enumerate(itertools.pairwise([0, *ends.tolist()])):
        near = rows[order[start:end] // asked]
        others = near[numbers[near] != number]
        through[others] |= around[number].looks_through(positions[others])
    return through


def _find_nearest(places: FloatArray, positions: FloatArray, count: int) -> IntArray:
    """Return the rows of so many of some places that are nearest to each position, (n, count)."""
    if count == len(places):
        return np.tile(np.arange(count), (len(positions), 1))
    from scipy.spatial import cKDTree  # takes its time

    found: IntArray = cKDTree(places).query(positions, k=count)[1]
    return found
