"""Lone lines: points along a wire or a thin pole, which have no surface.

::

    points in narrow boxes ── nearest points ──> along a line ── none else around? ──> lone line

Around a point of a wire the nearest points lie along it. So they do on a scan line, at a rim and
on a part as thin as the spacing; but there, a few times as far away, others do not. Around a wire
all do as far as it hangs free, for the wires beside it are lines, too. Lines that cover a
surface have been thinned before (see `scan_lines`), and are none any more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp import kernels
from hpcapp.applications.surface.scale.scan_lines import measure_spread
from hpcapp.geometry.lattice import lay_lattice, unique_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray

_COUNTS = 8, 16  # neighbours: noise hides a line among few, what is beside it does among many
_THIN = 0.02  # variance across a line, of that along it: see `measure_spread`
_FEWEST = 4  # points of a box, or with its neighbours, that show it
_LONE = 10.0
"""Times as far as the 8th neighbour, no point lies that is on no line. Of three wires 0.8 apart, 7
over the ground, all points have 12, and 99 % have 15; of the points of a stack of contours 5 % have
5, 0.3 % have 8, and none has 10."""

_FARTHEST = 3.0  # spacings of the whole cloud: neighbours on a line are no farther
_BOXES = 1.0, 3.0  # likewise: edges of boxes that show where lines may be

MARGIN = (_LONE + 1.0) * _FARTHEST
"""Spacings of the whole cloud: as far as what decides over a point lies."""

MOST = 0.5
"""Of all points: where more lie along lines, these are what was scanned, as a map's contours."""


def find_lone_lines(
    positions: FloatArray, own: BoolArray, low: FloatArray, spacing: float
) -> BoolArray:
    """Tell which own points (m,) of a region lie along lone lines.

    `positions` (n, 3) are all of the cloud in the region and within `MARGIN` spacings of it, `own`
    (n,) tells which lie in it, and `low` (3,) are the least coordinates of the cloud.
    """
    lines = _LineSearch(positions, low, spacing)
    rows = np.flatnonzero(lines.may_be())
    are_lines, _, nearest = lines.look(rows)
    rows, nearest = rows[are_lines], nearest[are_lines]
    # Most of them lie so by chance, and have a neighbour that does not.
    neighbours = unique_keys(nearest[nearest < len(positions)])
    others = neighbours[~lines.look(neighbours)[0]]
    among = ~np.isin(nearest, others).any(axis=1)
    # The neighbours of a point amid a line lie on that line, too.
    rows = unique_keys(np.column_stack([rows, nearest])[among].ravel())
    rows = rows[rows < len(positions)]
    lone = np.zeros(len(positions), np.bool_)
    lone[rows] = lines.find_room(rows, _LONE * lines.look(rows)[1])
    of_own: BoolArray = lone[own]
    return of_own


class _LineSearch:
    """What lies along a line among the points of a region."""

    def __init__(self, positions: FloatArray, low: FloatArray, spacing: float) -> None:
        self._positions, self._low, self._spacing = positions, low, spacing
        self._edge = max(_BOXES) * spacing
        self._cells = self._sort(max(_BOXES))

    def may_be(self) -> BoolArray:
        """Tell which points lie along a line with the others of their box, of whatever size."""
        found = np.zeros(len(self._positions), np.bool_)
        for size in _BOXES:
            _, offsets, rows = self._cells if size == max(_BOXES) else self._sort(size)
            counts = np.diff(offsets)
            tells = counts >= _FEWEST
            rows, counts = rows[np.repeat(tells, counts)], counts[tells]
            box = np.repeat(np.arange(len(counts)), counts)
            minors, traces = measure_spread(self._positions[rows], box)
            found[rows[np.repeat(minors <= _THIN * traces, counts)]] = True
        return found

    def _sort(self, size: float) -> tuple[IntArray, IntArray, NDArray[np.uint32]]:
        """Sort the points into boxes of so many spacings."""
        edge = size * self._spacing
        return kernels.sort_points(self._positions, lay_lattice(self._low, edge), edge)

    def look(self, rows: IntArray) -> tuple[BoolArray, FloatArray, IntArray]:
        """Tell whether points lie along a line, and how far and who the first neighbours are."""
        limit = _FARTHEST * self._spacing
        squares, nearest = kernels.find_nearest(
            self._positions, *self._cells, self._edge, rows, _COUNTS[-1], limit
        )
        are_lines = np.zeros(len(rows), np.bool_)
        for count in _COUNTS:
            # (m, count + 1): each point with its neighbours; a line shows at one count or another.
            near = np.column_stack([rows, nearest[:, :count]])
            is_there = near < len(self._positions)
            owner = np.nonzero(is_there)[0]
            minors, traces = measure_spread(self._positions[near[is_there]], owner)
            are_lines |= (minors <= _THIN * traces) & (is_there.sum(axis=1) >= _FEWEST)
        nearest = nearest[:, : _COUNTS[0]]
        reach = np.where(nearest < len(self._positions), squares[:, : _COUNTS[0]], 0.0)
        return are_lines, np.sqrt(reach.max(axis=1)), nearest

    def find_room(self, rows: IntArray, room: FloatArray) -> BoolArray:
        """Tell which points are farther than some lengths from all that lie along no line."""
        if not len(rows):
            return np.zeros(0, np.bool_)
        from scipy.spatial import cKDTree  # takes its time

        bound = float(room.max())
        away, _ = cKDTree(self._positions[rows]).query(
            self._positions, distance_upper_bound=bound * (1.0 + 1e-9)
        )
        # Only points as near as that matter, and of those only such as lie along no line.
        around = np.flatnonzero(away <= bound)
        others = around[~self.look(around)[0]]
        if not len(others):
            return np.ones(len(rows), np.bool_)
        away, _ = cKDTree(self._positions[others]).query(self._positions[rows])
        has_room: BoolArray = away > room
        return has_room
