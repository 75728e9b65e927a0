"""Places among what surrounds them: where somebody could stand who sees walls on many sides.

::

    patches ── cells ──> occupied ── 26 directions ──> cells that most of them leave blocked
                            └──── distance to what is occupied ──> the emptiest, one by one
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.normals.patches import CELL, Patches, quarter_patches
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass

AMPLE, TIGHT = 6.0, 4.0
"""Spacings between a place and the nearest patch: where nobody has said that somebody was inside,
and where somebody has. No sensor comes as close to a wall as a few times what lies between two of
its rays; a cloud that was thinned out may look so."""

INSIDE = 0.8
"""Share of the directions that are blocked inside of a room, a tunnel or a cave."""
AMID = 0.6, 0.4
"""And amid a street, a yard, a front: the sky is open, and what lies behind a scanner. With either
share alone 286 random scans that were left out of a fit were explained less well (logarithms of the
likelihood of -66.7 for -60.9), with .5 between them not better (-64.4)."""

_MOST = 512  # places: so many rooms, or some hundred metres of a tunnel
_TRIED = 20_000  # cells that they are picked of
_REACH = 16.0  # times as far as it is empty around most places: what lies farther is not looked at
_EDGE = 0.5  # of the cells, in those of patches
_CELLS = 2**20, 32  # at most, or so many for each patch: the box of a bent tunnel is mostly empty
_ROOMY = 0.35  # of the emptiest place's distance: nearer ones are no places to stand
_DIRECTIONS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where somebody could stand among what was scanned, and how far each is worth looking from.

    `every`, (s, 3), are 512 at most, along the longest side of the box; `emptiest` is (1, 3) or
    (0, 3).
    """

    every: FloatArray
    emptiest: FloatArray
    reach: float

    def __len__(self) -> int:
        return len(self.every)


def find_inside(
    patches: Patches,
    spacing: float,
    least: float,
    threads: int = 1,
    shares: Sequence[float] = (INSIDE,),
) -> list[Places]:
    """Find places that are inside of what surrounds them, all along a whole cloud.

    They are `least` spacings or more from the nearest patch, and found for each of the shares of
    directions that are blocked there; none where nothing surrounds anything.
    """
    parts = quarter_patches(patches, 0.25 * CELL * spacing)
    low, high = parts.min(axis=0), parts.max(axis=0)
    edge = _EDGE * CELL * spacing
    cells = float(np.maximum((high - low) / edge, 1.0).prod())
    edge *= max(1.0, cells / max(_CELLS[0], _CELLS[1] * len(patches))) ** (1.0 / 3.0)
    # (4 p, 3): the cell of each quarter, with an empty one before the first and after the last.
    rows = np.floor((parts - low) / edge).astype(np.int64) + 1
    occupied = np.zeros(rows.max(axis=0) + 2, np.bool_)
    occupied[tuple(rows.T)] = True
    # Of each cell, in how many of the 26 directions something lies.
    blocked = np.zeros(occupied.shape, np.int8)
    for step in _DIRECTIONS:
        blocked += _find_blocked(occupied, step)
    # (x, y, z): in cells, to the nearest one that is occupied.
    far = kernels.measure_distances(occupied, threads)
    found = []
    for share in shares:
        is_inside = blocked >= share * len(_DIRECTIONS)
        roomy = max(least * spacing / edge, _ROOMY * float(far[is_inside].max(initial=0.0)))
        chosen = np.argwhere(is_inside & (far >= roomy))
        picked, empty = _pick_emptiest(chosen, far[tuple(chosen.T)])
        # The middles of the cells; the first of them lies before `low`.
        middles = low + (picked - 0.5) * edge
        along = np.argsort(middles[:, int(np.argmax(high - low))], kind="stable")
        reach = _REACH * edge * float(np.median(empty)) if len(empty) else 0.0
        found.append(Places(middles[along], middles[:1], reach))
    return found


def _find_blocked(occupied: BoolArray, step: tuple[int, ...]) -> BoolArray:
    """Tell of which cells a line of cells, against `step`, meets an occupied one."""
    axis = int(np.flatnonzero(step)[0])
    # Plane after plane along an axis that the step has, in the order that the line crosses them.
    planes = np.moveaxis(occupied, axis, 0)[:: step[axis]]
    blocked = np.zeros(planes.shape, np.bool_)
    across = [shift for number, shift in enumerate(step) if number != axis]
    # The cells of a plane that have one behind them on the line, and these in the plane before.
    taken, given = (
        tuple(slice(max(way * shift, 0), min(way * shift, 0) or None) for shift in across)
        for way in (1, -1)
    )
    for plane in range(1, len(planes)):
        behind = blocked[plane - 1] | planes[plane - 1]
        blocked[plane][taken] = behind[given]
    return np.moveaxis(blocked[:: step[axis]], 0, axis)


def _pick_emptiest(cells: IntArray, far: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the emptiest cell, the emptiest one outside its ball, and so on; and how empty."""
    order = np.argsort(-far, kind="stable")[:: -(-len(cells) // _TRIED) or 1]
    cells, far = cells[order], far[order]
    picked: list[IntArray] = []
    empty: list[float] = []
    while len(cells) and len(picked) < _MOST:
        picked.append(cells[0])
        empty.append(float(far[0]))
        # The ball around it is empty: places in it see about the same.
        is_left = ((cells - cells[0]) ** 2).sum(axis=1) >= far[0] ** 2
        cells, far = cells[is_left], far[is_left]
    return np.array(picked, np.int64).reshape(-1, 3), np.array(empty)
