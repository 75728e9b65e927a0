"""Points through which a scanner has looked from elsewhere, or at another time: what moved.

::

    points of each look ──> how far away it saw something, in bins of directions
    a point of another look, nearer than all of that around its direction    ──> was not there
    what no other look tells, with more of such points around it than others ──> neither
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from hpcapp.applications.surface.reading.depth_sphere import DepthSphere
from hpcapp.applications.surface.reading.looks import Looks, find_looks, list_parts
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray, PointCloud
from hpcapp.geometry.validity import are_finite
from hpcapp.io import PointSource
from hpcapp.io.batches import batch_points

SEEN_THROUGH = "seen through from elsewhere"
"""Why points are left out of a file of several scans, or along a path of which times are known."""

MOST_ASKED = 8
"""Looks, the nearest to a point. Along a path to and fro through rooms 37 % of what moved goes with
4, 72 % with 8 and 77 % with 12; four more take about a microsecond a point."""

_BEYOND = 5.0
"""Bins across: so much farther away, at the point, is what was seen behind it. Of somebody who
stood in one of three scans of a room 82 to 98 % go with 1 bin, 78 to 96 % with 5 and 73 to 94 %
with 10, by the number of points; of a town, a room and a heap nothing. Where a room's noise is
3 cm, .07, .01 and .006 % of it go; where its scans do not fit by 10 cm, 2.8, 1.2 and .4 %."""

_MOST = 0.3  # of what a scan saw, or a path: where more go, scans stood elsewhere
_PATIENCE = 4  # times as many are looked at to find those along a path that are not too near
_TOGETHER = 0.5
"""Share of the rim of what no other look tells, beyond which it goes with what was looked through
around it. In four streets 85 % of what moved goes with it, and 54 % without; with a share of all of
its bins instead, floors that one scan sees go with who stands on them (.27 % of a room, not
.02)."""

_ROWS = 1 << 20  # at once


class SeenThrough:
    """What each look of a file saw, and so what of it was not there."""

    def __init__(self, looks: Looks, spheres: Mapping[int, DepthSphere]) -> None:
        self.looks, self._spheres = looks, spheres
        self._least = {number: one.find_least() for number, one in spheres.items()}
        self._gone: dict[int, BoolArray] = {}  # by bin, of looks of which something goes

    def find(self, positions: FloatArray, numbers: IntArray) -> BoolArray:
        """Tell which points (n, 3), of looks (n,), were not there."""
        goes = np.zeros(len(positions), np.bool_)
        for number, rows in group_rows(numbers):
            if number < 0:
                continue
            for other, asked in self.ask(positions[rows], number):
                distances, bins = self._spheres[other].find(positions[rows[asked]])
                goes[rows[asked]] |= self._is_through(other, bins, distances)
            if number in self._gone:
                sphere = self._spheres[number]
                distances, bins = sphere.find(positions[rows])
                goes[rows] |= self._gone[number][bins] & (
                    distances < _reach_beyond(sphere) * sphere.nearest[bins]
                )
        return goes

    def grow(self) -> bool:
        """Let go, of each look, what lies between what was not there, and no other look tells.

        False, and nothing is let go, where so much was not there that the places must be wrong: of
        a scan, or of a path as a whole.
        """
        from scipy.sparse import coo_matrix  # takes its time
        from scipy.sparse.csgraph import connected_components

        judged = {number: self._judge_bins(number) for number in self._spheres}
        # (s, 2): of each look the bins that go, and those in which it saw something
        counts = np.array([
            (np.count_nonzero(gone), np.count_nonzero(np.isfinite(self._spheres[number].nearest)))
            for number, (gone, _) in judged.items()
        ])  # fmt: skip
        if self.looks.is_path:
            counts = counts.sum(axis=0, keepdims=True)
        if (counts[:, 0] > _MOST * counts[:, 1]).any():
            return False
        for number, (is_gone, is_seen) in judged.items():
            if not is_gone.any():
                continue
            sphere = self._spheres[number]
            is_open = np.isfinite(sphere.nearest) & ~is_gone & ~is_seen
            # (p, 2): bins that touch, and whose depths follow each other
            pairs = sphere.list_neighbours()
            near, far = np.sort(sphere.nearest[pairs], axis=1).T
            pairs = pairs[far < _reach_beyond(sphere) * near]
            size, within = len(sphere.nearest), pairs[is_open[pairs].all(axis=1)]
            links = coo_matrix((np.ones(len(within), np.bool_), tuple(within.T)), (size, size))
            parts = connected_components(links, directed=False)[1]
            # (e, 2): a bin of a part, and one on its rim
            rim = np.concatenate([pairs, pairs[:, ::-1]])
            rim = rim[is_open[rim[:, 0]] & ~is_open[rim[:, 1]]]
            totals = np.bincount(parts[rim[:, 0]], minlength=size)
            hits = np.bincount(parts[rim[:, 0]], is_gone[rim[:, 1]], minlength=size)
            self._gone[number] = is_gone | is_open & (hits > _TOGETHER * totals)[parts]
        return True

    def _judge_bins(self, number: int) -> tuple[BoolArray, BoolArray]:
        """Tell, by bin of a look, (b,), what others look through, and what they have seen, too."""
        own = self._spheres[number]
        is_gone, is_seen = np.zeros((2, len(own.nearest)), np.bool_)
        there = np.flatnonzero(np.isfinite(own.nearest))
        positions = own.list_places(there)
        for other, asked in self.ask(positions, number):
            sphere = self._spheres[other]
            distances, bins = sphere.find(positions[asked])
            is_gone[there[asked]] |= self._is_through(other, bins, distances)
            off = np.abs(sphere.list_around(bins) / distances[:, None] - 1.0).min(axis=1)
            is_seen[there[asked]] |= off < _reach_beyond(sphere) - 1.0
        return is_gone, is_seen

    def ask(self, positions: FloatArray, number: int) -> Iterator[tuple[int, IntArray]]:
        """Yield looks that may judge points (n, 3) of one, and the rows of those they are asked of.

        Only so many are asked: what is asked of a point does not grow with the number of looks.
        """
        from scipy.spatial import cKDTree

        others = self.looks.list_others(number)
        if not len(others):
            return
        tree = cKDTree(np.stack([self._spheres[one].place for one in others]))
        # Of a path the nearest lie too near.
        count = min(MOST_ASKED * (_PATIENCE if self.looks.nearest else 1), len(others))
        away, nearest = tree.query(positions, k=np.arange(1, count + 1))
        is_far = away >= self.looks.nearest
        row, rank = np.nonzero(is_far & (np.cumsum(is_far, axis=1) <= MOST_ASKED))
        for which, pairs in group_rows(nearest[row, rank]):
            yield int(others[which]), row[pairs]

    def _is_through(self, number: int, bins: IntArray, distances: FloatArray) -> BoolArray:
        """Tell of which points, so far away in some bins, a look saw what is behind."""
        through: BoolArray = self._least[number][bins] > (
            _reach_beyond(self._spheres[number]) * distances
        )
        return through


def group_rows(numbers: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Yield each of some numbers, (n,), ascending, and the rows that have it."""
    order = np.argsort(numbers, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1):
        if len(rows):
            yield int(numbers[rows[0]]), rows


def _reach_beyond(sphere: DepthSphere) -> float:
    """Return how many times as far away something lies behind, not beside."""
    return 1.0 + _BEYOND * sphere.width


def look_around(source: PointSource, path: FloatArray) -> SeenThrough | None:
    """Return what each scan of a file saw, or a scanner on a path (n, 4) whose times are known.

    None where the file does not tell scans or times, or tells them wrongly.
    """
    looks = find_looks(source, path)
    if not len(looks.judges):
        return None
    spheres = {
        number: DepthSphere(looks.looks[number].place, looks.looks[number].points)
        for number in looks.judges.tolist()
    }
    for positions, numbers in list_parts(source, looks):
        for number, rows in group_rows(numbers):
            if number in spheres:
                spheres[number].add(positions[rows])
    around = SeenThrough(looks, spheres)
    return around if around.grow() else None


def drop_seen_through(source: PointSource, path: FloatArray) -> PointSource:
    """Return the points of a file without those that were not there from another look.

    Where a file tells no scans apart, or not where each stood, nor times that are those of the path
    (n, 4), it is the same. It is read twice, and three times with a path.
    """
    around = look_around(source, path)
    if around is None:
        return source

    def scan(rows: int) -> Iterator[PointCloud]:
        source.findings.dropped.pop(SEEN_THROUGH, None)  # they are counted anew
        return batch_points(_keep(source, around, max(rows, _ROWS)), rows)

    return replace(source, scan=scan, records=None, check_rest=None, octree=None)


def are_seen_through(cloud: PointCloud, around: SeenThrough | None) -> BoolArray:
    """Tell which points of a file, (n,), were not there from another look."""
    goes = np.zeros(len(cloud), np.bool_)
    numbers = None if around is None else around.looks.number(cloud)
    if around is None or numbers is None:
        return goes
    rows = np.flatnonzero(are_finite(cloud.positions))
    goes[rows] = around.find(cloud.positions[rows] + cloud.origin, numbers[rows])
    return goes


def _keep(source: PointSource, around: SeenThrough, rows: int) -> Iterator[PointCloud]:
    for part in source.scan(rows):
        through = are_seen_through(part, around)
        source.findings.drop(SEEN_THROUGH, int(np.count_nonzero(through)))
        yield part.take(np.flatnonzero(~through))
