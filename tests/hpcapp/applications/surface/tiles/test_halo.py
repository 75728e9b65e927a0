"""A slab sees the bricks beside it as another's."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.tiles.halo import cut_slab
from hpcapp.kernels.types.grid import BESIDE, FOREIGN, OPEN, OUT, OWN, BrickKinds, Grid

GRID = Grid(np.zeros(3), 0.1, (20, 20, 20))
LAYERS = [OUT, OPEN, OWN, FOREIGN, OWN, BESIDE]


def tile() -> BrickKinds:
    """Return a box of six layers along x from layer 10 on, each of one kind."""
    kinds = np.repeat(np.array(LAYERS, np.uint8), 6).reshape(6, 2, 3)
    return BrickKinds(np.array([10, 4, 5]), kinds)


@pytest.mark.parametrize(
    ("first", "end", "low", "layers"),
    [
        (10, 16, 10, LAYERS),
        (12, 13, 11, [BESIDE, OWN, FOREIGN]),
        (11, 12, 11, [OPEN, FOREIGN]),
        (13, 14, 13, [FOREIGN]),
        (10, 11, 10, [OUT]),
        (14, 16, 13, [FOREIGN, OWN, BESIDE]),
    ],
)
def test_a_slab_has_a_layer_beside_it_where_the_tile_has_one(
    first: int, end: int, low: int, layers: list[int]
) -> None:
    whole = tile()
    slab = cut_slab(GRID, whole, first, end)
    assert slab.first.tolist() == [low, 4, 5]
    assert slab.kinds[:, 0, 0].tolist() == layers
    assert (slab.kinds == slab.kinds[:, :1, :1]).all()
    slab.kinds[:] = OUT
    assert whole.kinds[:, 0, 0].tolist() == LAYERS  # it was a copy


def test_marks_outside_the_box_are_lost() -> None:
    kinds = tile()
    keys = np.append(kinds.own(), -1)
    kinds.mark(keys, OPEN)
    assert kinds.kinds[:, 1, 2].tolist() == [OUT, OPEN, OPEN, FOREIGN, OPEN, BESIDE]
