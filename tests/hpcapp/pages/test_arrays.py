"""What a page holds is read back as its program reads it."""

from __future__ import annotations

import base64
import gzip
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.pages.arrays import Packable, PackedArray, pack_array, quantise


def unpack(array: PackedArray) -> NDArray[np.generic]:
    """Decode an array, number by number, as ``static/page.js`` does."""
    size, rows, columns = int(array.type[1:]), array.rows, array.columns
    packed = gzip.decompress(base64.b64decode(array.packed))
    count = rows * columns
    assert len(packed) == count * size
    values = np.zeros((rows, columns), f"u{size}")
    for column in range(columns):
        last = 0
        for row in range(rows):
            at = column * rows + row
            step = sum(packed[plane * count + at] << (8 * plane) for plane in range(size))
            last += (step >> 1) ^ -(step & 1)
            values[row, column] = last % 2 ** (8 * size)
    return values


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32])
@pytest.mark.parametrize("columns", [1, 3])
def test_every_number_comes_back(
    dtype: type[np.uint8 | np.uint16 | np.uint32], columns: int
) -> None:
    most = np.iinfo(dtype).max
    rng = np.random.default_rng(1)
    values = cast(Packable, rng.integers(0, most, (200, columns), dtype=dtype, endpoint=True))
    values[:4] = [[0], [most], [0], [most // 2]]
    np.testing.assert_array_equal(unpack(pack_array("a", values)), values)


def test_no_rows_are_an_array_too() -> None:
    assert unpack(pack_array("a", np.empty((0, 3), np.uint16))).shape == (0, 3)


def test_neighbours_that_are_near_take_little_room() -> None:
    near = np.arange(30_000, dtype=np.uint32)
    assert len(pack_array("a", near).packed) < 1000


def test_places_move_by_less_than_a_step() -> None:
    places = np.random.default_rng(2).normal(size=(500, 3)) * [1.0, 20.0, 3.0]
    low, high = places.min(axis=0), places.max(axis=0)
    step = (high - low).max() / 65535
    back = low + step * quantise(places, low, high)
    assert np.abs(back - places).max() <= 0.5 * step * (1 + 1e-9)


def test_one_place_has_no_extent() -> None:
    assert not quantise(np.ones((2, 3)), np.ones(3), np.ones(3)).any()
