from __future__ import annotations

import numpy as np
import pytest

from hpcapp import kernels
from hpcapp.applications.surface.field.ancestors import corners_at
from hpcapp.applications.surface.field.pyramid import lay_vertices
from hpcapp.geometry.lattice import pack_places, unique_keys, unpack_keys
from hpcapp.geometry.points import IntArray
from hpcapp.kernels.portable.lattice.keys import mark_ancestors


@pytest.fixture(scope="module")
def cells() -> IntArray:
    random = np.random.default_rng(3)
    directions = random.normal(size=(900, 3))
    shell = 20.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return unique_keys(pack_places(np.floor(shell).astype(np.int64)))


def test_marks_tell_where_the_finest_cells_lie() -> None:
    cells = pack_places(np.array([[0, 3, -1], [1, 0, 5]]))
    ancestors = pack_places(np.array([[0, 0, -1], [0, 0, 0], [0, 0, 1]]))
    marks = mark_ancestors(cells, 2, ancestors)
    assert marks.tolist() == [1 << (0 + 3 * 2 + 9 * 2), 0, 1 << (1 + 3 * 0 + 9 * 1)]


@pytest.mark.parametrize("depth", [1, 2, 3])
@pytest.mark.parametrize("one_in", [1, 7])
def test_corners_laid_at_a_level_are_the_ancestors_of_the_finest(
    cells: IntArray, depth: int, one_in: int
) -> None:
    ancestors = unique_keys(pack_places(unpack_keys(cells) >> depth))
    own = cells[::one_in]
    marks = mark_ancestors(own, depth, ancestors)
    parents = unique_keys(pack_places(unpack_keys(own) >> depth))
    assert np.array_equal(ancestors[marks > 0], parents)
    expected = lay_vertices(kernels.spread_keys(own, -1, 2), depth + 1)[depth]
    assert np.array_equal(corners_at(ancestors, marks), expected)
