from __future__ import annotations

import itertools

import numpy as np
import pytest

from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels.constants import COLUMNS, MONOMIALS
from hpcapp.kernels.portable.quadrics.moments import (
    EXPONENTS,
    accumulate_moments,
    scale_moments,
    shift_moments,
)

SortedCells = tuple[FloatArray, FloatArray, IntArray]


def test_there_are_as_many_monomials_as_the_kernels_go_by() -> None:
    assert len(EXPONENTS) == MONOMIALS == COLUMNS - 9


@pytest.fixture
def cells() -> SortedCells:
    """Seven cells of uneven size, one of them larger than a chunk of the kernel."""
    rng = np.random.default_rng(7)
    counts = np.array([1, 5, 20_000, 3, 130, 1, 9])
    normals = rng.normal(size=(counts.sum(), 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return rng.uniform(-0.5, 0.5, (counts.sum(), 3)), normals, offsets


def gradients(points: FloatArray) -> FloatArray:
    """grad phi_i for x, y, z, xx, yy, zz, xy, yz, zx: shape (9, n, 3)."""
    x, y, z = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows = [
        (one, zero, zero), (zero, one, zero), (zero, zero, one),
        (2 * x, zero, zero), (zero, 2 * y, zero), (zero, zero, 2 * z),
        (y, x, zero), (zero, z, y), (z, zero, x),
    ]  # fmt: skip
    return np.array(rows).transpose(0, 2, 1)


def plain_moments(points: FloatArray, normals: FloatArray) -> FloatArray:
    monomials = [np.prod(points ** np.array(e), axis=1).sum() for e in EXPONENTS]
    return np.array([*monomials, *(gradients(points) * normals).sum(axis=(1, 2))])


def test_each_exponent_of_degree_up_to_four_occurs_once() -> None:
    assert MONOMIALS == len(set(EXPONENTS)) == 35
    assert max(sum(e) for e in EXPONENTS) == 4
    assert COLUMNS == 44


def test_moments_are_the_sums_they_say(cells: SortedCells) -> None:
    positions, normals, offsets = cells
    moments = accumulate_moments(positions, normals, offsets)
    for row, (a, b) in zip(moments, itertools.pairwise(offsets), strict=True):
        np.testing.assert_allclose(row, plain_moments(positions[a:b], normals[a:b]), atol=1e-9)
    assert np.array_equal(moments[:, 0], np.diff(offsets))


@pytest.mark.parametrize("cut", [1, 2, 3, 6])
def test_a_row_does_not_depend_on_its_batch(cells: SortedCells, cut: int) -> None:
    positions, normals, offsets = cells
    whole = accumulate_moments(positions, normals, offsets)
    point = offsets[cut]
    first = accumulate_moments(positions[:point], normals[:point], offsets[: cut + 1])
    second = accumulate_moments(positions[point:], normals[point:], offsets[cut:] - point)
    assert np.array_equal(np.concatenate([first, second]), whole)


def test_sums_run_in_the_order_of_the_points(
    cells: SortedCells,
) -> None:
    positions, normals, offsets = cells
    total = 0.0
    for x in positions[offsets[2] : offsets[3], 0].tolist():
        total += x
    assert accumulate_moments(positions, normals, offsets)[2, 1] == total


@pytest.mark.parametrize("shift", [(0.5, -0.5, 0.5), (0.3, 0.0, -1.7)])
def test_shifted_moments_are_those_of_shifted_points(
    cells: SortedCells, shift: tuple[float, float, float]
) -> None:
    positions, normals, offsets = cells
    shifted = shift_moments(accumulate_moments(positions, normals, offsets), np.array(shift))
    expected = accumulate_moments(positions + shift, normals, offsets)
    np.testing.assert_allclose(shifted, expected, rtol=1e-9, atol=1e-8)


def test_a_shift_of_one_row_does_not_depend_on_the_others() -> None:
    moments = np.random.default_rng(1).normal(size=(5000, COLUMNS))
    shift = np.array([0.5, -0.5, 0.5])
    whole = shift_moments(moments, shift)
    assert np.array_equal(shift_moments(moments[4090:4100], shift), whole[4090:4100])


@pytest.mark.parametrize("rows", [1, 2, 4097])
def test_shifting_leaves_its_input_alone(rows: int) -> None:
    moments = np.random.default_rng(2).normal(size=(rows, COLUMNS))
    before = moments.copy()
    shift_moments(moments, np.array([0.5, 0.5, -0.5]))
    assert np.array_equal(moments, before)


def test_scaled_moments_are_those_of_cells_of_twice_the_size(
    cells: SortedCells,
) -> None:
    positions, normals, offsets = cells
    scaled = scale_moments(accumulate_moments(positions, normals, offsets))
    np.testing.assert_allclose(
        scaled, accumulate_moments(positions / 2, normals, offsets), rtol=1e-9, atol=1e-8
    )
