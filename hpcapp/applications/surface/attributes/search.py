"""The attributes of a cloud that is not in memory, at places on its surface.

Places are cut into groups; for each the points around are read, up to a margin in which the nearest
ones should be. Places that find theirs farther away, as in holes of the scan, are looked at again
with a margin that holds them for sure. So each takes what it would of the whole cloud, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

import numpy as np

from hpcapp.applications.surface.attributes.carry import NEIGHBOURS, AttributeField, Carried
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.geometry.lattice import unpack_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray, PointCloud
from hpccomponent.dataclass import dataclass

_SLACK = 1.0 + 1e-9  # for the rounding of distances


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """A cloud, and what is to be found in it."""

    cloud: ArrangedCloud
    take: Callable[[IntArray], PointCloud]
    labels: Collection[str]
    threads: int
    points: int

    def find(self, places: FloatArray, margin: float) -> Iterator[tuple[IntArray, Carried]]:
        """Yield rows of the places, and what they take; all of them in the end."""
        waiting = [(np.arange(len(places)), margin)]
        while waiting:
            rows, margin = waiting.pop()
            low, high = places[rows].min(axis=0), places[rows].max(axis=0)
            keys, counts = self._blocks_near(low, high, margin)
            # Below a part of a block, a smaller group would read as many points.
            least = max(margin, 0.25 * self.cloud.arrangement.edge)
            if counts.sum() > self.points and (high - low).max() > least:
                waiting += [(half, margin) for half in _halve(rows, places[rows])]
                continue
            near = self._read_near(keys, counts, low, high, margin)
            is_whole = len(keys) == len(self.cloud.keys) and len(near) == len(self.cloud)
            if len(near) <= NEIGHBOURS and not is_whole:
                waiting.append((rows, 2.0 * margin))
                continue
            found = AttributeField(near, self.labels, self.threads).evaluate(places[rows])
            done = np.full(len(rows), is_whole) | (found.farthest * _SLACK <= margin)
            if done.any():
                yield rows[done], found if done.all() else _select(found, done)
            if not done.all():
                # The points that were found are a bound on how far away the nearest can be.
                far = found.farthest[~done]
                for some in _by_distance(far):
                    waiting.append((rows[~done][some], float(far[some].max()) * _SLACK * _SLACK))

    def _blocks_near(
        self, low: FloatArray, high: FloatArray, margin: float
    ) -> tuple[IntArray, IntArray]:
        """Return the blocks that come near a box, and how many points they hold."""
        blocks, keys = self.cloud.arrangement, self.cloud.keys
        corners = unpack_keys(keys) * blocks.edge + blocks.origin
        near = ((corners <= high + margin) & (corners + blocks.edge >= low - margin)).all(axis=1)
        return keys[near], self.cloud.counts[near]

    def _read_near(
        self, keys: IntArray, counts: IntArray, low: FloatArray, high: FloatArray, margin: float
    ) -> PointCloud:
        """Return the points within the margin around a box, read some blocks at a time."""
        parts = []
        cuts = np.flatnonzero(np.diff(np.cumsum(counts) // self.points)) + 1
        for run in np.split(keys, cuts) if len(keys) else []:
            some = self.take(run)
            away = np.maximum(np.maximum(low - some.positions, some.positions - high), 0.0)
            is_near = np.einsum("ij,ij->i", away, away) <= margin * margin * _SLACK
            parts.append(some if is_near.all() else some.take(is_near))
        return _join(parts) if parts else PointCloud(np.empty((0, 3)))


def evaluate_blocks(
    cloud: ArrangedCloud,
    take: Callable[[IntArray], PointCloud],
    labels: Collection[str],
    spacing: float,
    places: FloatArray,
    threads: int = 1,
    points: int = 1 << 20,
) -> Carried:
    """Return what places (n, 3) take from the points of a cloud that is not in memory.

    `take`, given sorted keys of blocks, returns their points with the columns (see `ColumnBlocks`);
    of `labels` no mean is taken; places are in the frame of the cloud. `spacing` decides about
    time, not about values. So many `points` are in memory at once, about, with some hundred bytes
    each. The result is that of `AttributeField.evaluate` of all at once, but for `farthest`.
    """
    search = _Search(cloud, take, labels, threads, points)
    order, parts = [np.empty(0, np.int64)], []
    for rows, found in search.find(places, 4.0 * spacing) if len(places) else ():
        order.append(rows)
        parts.append(found)
    if not parts:
        return AttributeField(take(cloud.keys[:1]), labels).evaluate(places)
    back = np.argsort(np.concatenate(order))
    carried = _join([part.points for part in parts]).take(back)
    return Carried(
        PointCloud(places, None, carried.colours, carried.attributes),
        np.concatenate([part.nearest for part in parts])[back],
        np.concatenate([part.farthest for part in parts])[back],
    )


def _halve(rows: IntArray, places: FloatArray) -> list[IntArray]:
    """Cut places in two halves, across their longest side."""
    axis = int(np.argmax(places.max(axis=0) - places.min(axis=0)))
    order = np.argsort(places[:, axis], kind="stable")
    return [rows[half] for half in np.array_split(order, 2) if len(half)]


def _by_distance(far: FloatArray) -> Iterator[IntArray]:
    """Yield places that need margins of about the same size."""
    classes = np.floor(np.log2(far / far.min()))
    for one in np.unique(classes):
        yield np.flatnonzero(classes == one)


def _select(found: Carried, rows: BoolArray) -> Carried:
    return Carried(found.points.take(rows), found.nearest[rows], found.farthest[rows])


def _join(parts: list[PointCloud]) -> PointCloud:
    """Return some clouds with the same columns as one, without normals."""
    if len(parts) == 1:
        return parts[0]
    colours = [part.colours for part in parts if part.colours is not None]
    return PointCloud(
        np.concatenate([part.positions for part in parts]),
        None,
        np.concatenate(colours) if colours else None,
        {
            name: np.concatenate([part.attributes[name] for part in parts])
            for name in parts[0].attributes
        },
    )
