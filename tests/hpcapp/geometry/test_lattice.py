from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hpcapp.geometry.lattice import (
    OCTANTS,
    ancestor_keys,
    are_sampled,
    cells_of,
    corner_parents,
    find_keys,
    keys_lie_within,
    pack_places,
    shift_within,
    shuffle_keys,
    spread_keys,
    step_keys,
    unique_keys,
    unpack_keys,
)
from hpcapp.geometry.points import IntArray
from hpccomponent.errors import InputError

LIMIT = 2**20 - 1
places_lists = arrays(np.int64, st.tuples(st.integers(1, 30), st.just(3)),
                      elements=st.integers(-LIMIT, LIMIT))  # fmt: skip


@given(places_lists)
def test_keys_hold_their_places_and_sort_like_them(places: IntArray) -> None:
    keys = pack_places(places)
    assert np.array_equal(unpack_keys(keys), places)
    by_key = places[np.argsort(keys, kind="stable")].tolist()
    assert by_key == sorted(places.tolist())


@given(places_lists, st.tuples(*[st.integers(-2, 2)] * 3))
def test_a_step_of_keys_is_a_step_of_places(places: IntArray, step: tuple[int, int, int]) -> None:
    places = places // 2
    stepped = step_keys(pack_places(places), np.array(step))
    assert np.array_equal(unpack_keys(stepped), places + step)


@given(places_lists, st.integers(0, 20))
def test_an_ancestor_of_keys_is_that_of_their_places(places: IntArray, levels: int) -> None:
    edges = np.array([[-(2**20)] * 3, [2**20 - 1] * 3, [-1, 0, -(2**20)]])
    places = np.concatenate([places.reshape(-1, 3), edges])
    found = ancestor_keys(pack_places(places), levels)
    np.testing.assert_array_equal(found, pack_places(places >> levels))


@given(places_lists, places_lists)
def test_keys_lie_within_the_box_of_their_places(places: IntArray, others: IntArray) -> None:
    keys, box = pack_places(places), (others.min(axis=0), others.max(axis=0))
    is_inside = bool(((places >= box[0]) & (places <= box[1])).all())
    assert keys_lie_within(keys, *box) == is_inside
    assert keys_lie_within(keys, places.min(axis=0), places.max(axis=0))


def test_places_are_shifted_up_to_the_last_that_have_a_key() -> None:
    shifted = shift_within(np.array([-1e30, 0.0, LIMIT]), 1)
    assert shifted.tolist() == [-LIMIT - 1, 1, LIMIT]
    assert len(unpack_keys(pack_places(shifted))) == 3


def test_a_place_out_of_range_is_refused() -> None:
    with pytest.raises(InputError, match="cells of the lattice"):
        pack_places(np.array([[0, 2**20, 0]]))


def test_keys_that_are_missing_get_the_row_past_the_end() -> None:
    keys = np.array([3, 5, 9])
    assert find_keys(keys, np.array([[5, 4], [9, 10]])).tolist() == [[1, 3], [2, 3]]


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-1, 2)])
def test_spreading_finds_the_box_around_every_place(low: int, high: int) -> None:
    places = np.random.default_rng(0).integers(-5, 5, (20, 3))
    spread = spread_keys(np.unique(pack_places(places)), low, high)
    steps = np.stack(np.meshgrid(*[np.arange(low, high + 1)] * 3), axis=-1).reshape(-1, 3)
    expected = {tuple(row) for row in (places[:, None] + steps).reshape(-1, 3).tolist()}
    assert {tuple(row) for row in unpack_keys(spread).tolist()} == expected
    assert (np.diff(spread) > 0).all()


@given(places_lists)
def test_the_mean_of_the_parents_is_the_place_of_the_child(places: IntArray) -> None:
    mean = np.zeros(places.shape)
    for octant in OCTANTS:
        keys, steps = corner_parents(places, octant)
        assert np.array_equal(2 * unpack_keys(keys) + steps, places)
        assert np.abs(steps).max() <= 1
        mean += 2 * unpack_keys(keys) / 8
    assert np.array_equal(mean, places)


def test_cells_count_from_the_origin() -> None:
    cells = cells_of(np.array([[2.5, 1.0, 0.0]]), np.array([0.5, 1.0, 1.0]), 0.5)
    assert cells.tolist() == [[4.0, 0.0, -2.0]]


def test_a_sample_of_shuffled_keys_has_no_pattern() -> None:
    places = np.stack(np.meshgrid(*[np.arange(32)] * 3), axis=-1).reshape(-1, 3)
    keys = shuffle_keys(pack_places(places))
    assert len(unique_keys(keys)) == len(keys)
    sample = places[are_sampled(keys, 16)]
    assert len(sample) == pytest.approx(len(keys) / 16, rel=0.1)
    for step in ((1, 0, 0), (0, 0, 1), (1, 1, 0), (2, 1, 3)):
        beside = find_keys(np.sort(pack_places(sample)), pack_places(sample + np.array(step)))
        assert (beside < len(sample)).mean() == pytest.approx(1 / 16, abs=0.025)
