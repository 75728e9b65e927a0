from __future__ import annotations

import numpy as np
import pytest

from hpcapp.geometry.lattice import pack_places
from hpcapp.geometry.points import BoolArray
from hpcapp.kernels.portable.surface.rims import mark_rim
from hpcapp.kernels.types.grid import BRICK, MOST_SHIFT, BrickStrides, Grid


def middle_of(side: int) -> BoolArray:
    bricks = np.zeros((side, side, side), np.bool_)
    bricks[side // 2, side // 2, side // 2] = True
    return bricks


def test_without_strides_the_rim_is_the_26_neighbours() -> None:
    expected = np.zeros((7, 7, 7), np.bool_)
    expected[2:5, 2:5, 2:5] = True
    assert np.array_equal(mark_rim(middle_of(7), None), expected)
    assert np.array_equal(mark_rim(middle_of(7), np.full((7, 7, 7), BRICK, np.uint8)), expected)


@pytest.mark.parametrize("shift", range(MOST_SHIFT + 1))
def test_a_rim_is_eight_cells_deep(shift: int) -> None:
    cells = np.full((21, 21, 21), BRICK >> shift, np.uint8)
    marked = mark_rim(middle_of(21), cells)
    assert np.flatnonzero(marked[10, 10]).tolist() == list(range(10 - 2**shift, 11 + 2**shift))
    assert marked.sum() == (2 ** (shift + 1) + 1) ** 3


def test_a_way_around_fine_bricks_counts() -> None:
    cells = np.full((5, 9, 1), 1, np.uint8)
    cells[2, 1:] = BRICK  # a wall of fine bricks, and a gap in it
    bricks = np.zeros(cells.shape, np.bool_)
    bricks[1, 2] = True
    marked = mark_rim(bricks, cells)
    assert marked[2, :4].all()  # beside it, and those that the way leads past
    assert marked[3:, :6].all()
    assert marked[3, 6]
    cells[2, 0] = BRICK
    assert not mark_rim(bricks, cells)[3:].any()


def test_bricks_that_are_not_listed_are_one_cell() -> None:
    keys = pack_places(np.array([[1, 2, 3], [4, 0, 0]]))
    strides = BrickStrides(keys, np.array([1, 0], np.uint8))
    asked = np.append(keys, pack_places(np.array([[0, 0, 0]])))
    assert strides.at(asked).tolist() == [1, 0, MOST_SHIFT]
    cells = strides.cells_within(np.array([1, 1, 1]), (2, 2, 3))
    assert cells[0, 1, 2] == BRICK // 2
    assert cells.sum() == BRICK // 2 + 2 * 2 * 3 - 1
    assert Grid(np.zeros(3), 1.0, (5, 5, 5)).rim == 1
    assert Grid(np.zeros(3), 1.0, (5, 5, 5), strides).rim == BRICK
