"""How coarse the grid is in each brick: its cells follow the points, as those of the lattice do.

::

    bricks with points ── spacing there ──> stride ── the finest of 26 neighbours ──>
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.field.far_field import FEWEST_NODES, far_step
from hpcapp.applications.surface.field.refinement import Refinement
from hpcapp.geometry.lattice import NEIGHBOURS, find_first, step_keys, unpack_keys
from hpcapp.geometry.points import IntArray
from hpcapp.kernels.types.grid import BRICK, MOST_SHIFT, BrickStrides, Grid

_STEPS = 1.25  # of the grid, across the smallest cells that points are dense enough for
_EARLY = 0.25  # doublings: steps are up to a fifth larger than the spacing


def choose_strides(grid: Grid, seeds: IntArray, refinement: Refinement) -> BrickStrides | None:
    """Choose the strides of all bricks; None where all with points ask for the same step.

    The grid's step is that of bricks where the lattice is finest; `seeds`, (s,), are sorted keys of
    the bricks that hold points.
    """
    edge = BRICK * grid.step
    middles = grid.origin + edge * (unpack_keys(seeds) + 0.5)
    # (s,): how often the step may be doubled; where points are densest it is as asked for.
    cells = np.maximum(refinement.wanted_sizes(middles), refinement.cell_size)
    doublings = np.log2(cells / (_STEPS * grid.step)) + _EARLY
    doublings -= max(0.0, np.floor(doublings.min()))
    doublings = np.floor(doublings).clip(0, MOST_SHIFT)
    if not doublings.any():
        return None
    # Where there are no points, cells are no larger than those of the far field.
    far = np.log2(far_step(*grid.box, FEWEST_NODES) / grid.step)
    # (27 s,): beside a brick with points the surface is as fine: sorted by the finest first.
    spread = np.concatenate([step_keys(seeds, step) for step in NEIGHBOURS])
    exponents = np.tile(doublings, len(NEIGHBOURS)).astype(np.uint8)
    order = np.argsort(exponents, kind="stable")
    keys, first = find_first(spread[order])
    rest = int(np.clip(np.floor(far), doublings.max(), MOST_SHIFT))
    return BrickStrides(keys, exponents[order][first], rest)
