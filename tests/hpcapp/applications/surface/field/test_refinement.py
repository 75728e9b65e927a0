from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hpcapp import kernels
from hpcapp.applications.surface.field.local_noise import LocalNoise
from hpcapp.applications.surface.field.refinement import Refinement
from hpcapp.applications.surface.scale.local_scale import LocalScale, count_scale, make_scale
from hpcapp.geometry.lattice import ancestor_keys, find_keys, pack_places, unique_keys, unpack_keys
from hpcapp.geometry.points import FloatArray, IntArray

ORIGIN = np.zeros(3)


def two_densities() -> FloatArray:
    """Points of a sheet over [0, 8]^2: 0.1 apart where x is below 2, else 0.4 apart."""
    places = []
    for low, high, spacing in ((0.0, 2.0, 0.1), (2.0, 8.0, 0.4)):
        x, y = np.meshgrid(np.arange(low, high, spacing), np.arange(0.0, 8.0, spacing))
        places.append(np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.05)], axis=1))
    return np.concatenate(places)


def refine(levels: int) -> tuple[Refinement, list[IntArray]]:
    """Return a refinement by that scan, with its cells from the finest level to the base."""
    positions = two_densities()
    scale = make_scale(0.3, ORIGIN, 1.0, [count_scale(positions, ORIGIN, 1.0, 4)])
    refinement = Refinement(levels, 1.25, scale, ORIGIN, 0.2, LocalNoise.none())
    finest = unique_keys(pack_places(np.floor(positions / 0.2).astype(np.int64)))
    return refinement, refinement.cells_above(finest)


def test_cells_are_divided_where_points_are_dense_enough() -> None:
    refinement, cells = refine(2)
    for depth, size in ((1, 0.4), (2, 0.8)):
        low = size * unpack_keys(cells[depth])[:, 0]
        divided = refinement.divides(cells[depth], depth)
        assert divided[low + size <= 2.0].all()
        assert not divided[low >= 3.0].any()  # cells of the scale are 1 and larger
    assert not refinement.divides(cells[0], 0).any()
    assert not refinement.divides(cells[2], 3).any()


def test_no_finer_quadrics_lie_around_what_is_marked() -> None:
    refinement, cells = refine(2)
    laid = refinement.lay(cells[:2], kernels.spread_keys(cells[2], -1, 2))
    for depth in (1, 2):
        is_finest = refinement.mark_finest(laid[depth], cells[depth], depth)
        divided = cells[depth][refinement.divides(cells[depth], depth)]
        inner = kernels.spread_keys(divided, 0, 1)
        leaves = kernels.spread_keys(np.setdiff1d(cells[depth], divided), 0, 1)
        assert np.array_equal(laid[depth][is_finest], np.intersect1d(leaves, laid[depth]))
        assert not is_finest[np.isin(laid[depth], np.setdiff1d(inner, leaves))].any()
    assert refinement.mark_finest(laid[0], cells[0], 0).all()


def test_ancestors_of_all_corners_are_there() -> None:
    refinement, cells = refine(2)
    base = kernels.spread_keys(cells[2], -1, 2)
    laid = refinement.lay(cells[:2], base)
    assert np.array_equal(laid[2], np.union1d(base, kernels.parent_keys(laid[1])))
    for finer, coarser in pairwise(laid):
        parents = kernels.parent_keys(finer)
        assert (find_keys(coarser, parents) < len(coarser)).all()
    children = cells[0][refinement.divides(ancestor_keys(cells[0]), 1)]
    corners = kernels.spread_keys(children, -1, 2)
    assert np.array_equal(laid[0], corners)


@pytest.mark.parametrize("depth", [0, 1, 5])
def test_without_refinement_the_finest_level_is_the_only_one(depth: int) -> None:
    cells = pack_places(np.array([[0, 0, 0], [4, 2, 1]]))
    corners = kernels.spread_keys(cells, 0, 1)
    none = Refinement.none()
    assert none.mark_finest(corners, cells, depth).all() == (depth == 0)
    assert not none.divides(cells, depth).any()
    assert none.lay([], corners)[0] is corners
    assert LocalScale.uniform(1.0).range == (1.0, 1.0)
