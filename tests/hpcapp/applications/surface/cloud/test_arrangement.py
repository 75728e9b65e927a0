"""Arranged points are the same points: exact, in one order, however they are packed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.applications.surface.cloud.arrangement import (
    Arrangement,
    choose_arrangement,
    pack_points,
    snap_points,
    unpack_points,
)
from hpcapp.geometry.lattice import pack_places, unpack_keys
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import InputError


def _cloud(points: int, scale: float, shift: float) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(points)
    positions = shift * scale + scale * random.normal(size=(points, 3)) * (1.0, 0.3, 0.7)
    normals = random.normal(size=(points, 3))
    return positions, normals / np.linalg.norm(normals, axis=1)[:, None]


def _arrange(positions: FloatArray) -> Arrangement:
    return choose_arrangement(positions.min(axis=0), positions.max(axis=0))


@given(st.floats(1e-50, 1e50), st.floats(-10.0, 10.0))
def test_a_cloud_lies_in_the_same_blocks_and_quanta_wherever_it_lies(
    scale: float, shift: float
) -> None:
    positions, normals = _cloud(200, 1.0, 0.0)
    found = pack_points(_arrange(positions), positions, normals)
    moved = scale * positions + scale * shift
    again = pack_points(_arrange(moved), moved, normals)
    assert found.keys.tolist() == again.keys.tolist()
    assert found.counts.tolist() == again.counts.tolist()
    # Where a coordinate falls on the face of a quantum, the one beside it may be taken.
    np.testing.assert_allclose(found.offsets, again.offsets, rtol=0.0, atol=2.0**-23)
    assert (found.offsets == again.offsets).mean() > 0.99


def test_a_cloud_touches_64_blocks_along_its_longest_side() -> None:
    positions, normals = _cloud(200_000, 1.0, 0.0)
    places = unpack_keys(pack_points(_arrange(positions), positions, normals).keys)
    assert places.min(axis=0).tolist() == [0, 0, 0]
    assert places.max() == 63


@pytest.mark.parametrize("scale", [1e-40, 1.0, 3e5, 1e50])
@pytest.mark.parametrize("shift", [0.0, -7.3, 1e7, -3e12])
def test_points_are_packed_and_unpacked_bit_for_bit(scale: float, shift: float) -> None:
    """Also where float32 could hold neither the coordinates nor their differences."""
    positions, normals = _cloud(2_000, scale, shift)
    arrangement = _arrange(positions)
    snapped = snap_points(arrangement, positions)
    longest = np.ptp(positions, axis=0).max()
    assert np.abs(snapped - positions).max() < max(1e-9 * longest, 2e-15 * np.abs(positions).max())
    packed = pack_points(arrangement, positions, normals)
    places = np.floor((snapped - arrangement.origin) / arrangement.edge).astype(np.int64)
    order = np.argsort(pack_places(places), kind="stable")
    unpacked, turned = unpack_points(arrangement, packed)
    assert unpacked.tobytes() == snapped[order].tobytes()
    assert turned.tobytes() == normals[order].astype(np.float32).astype(np.float64).tobytes()
    assert packed.offsets.min() >= 0.0
    assert packed.offsets.max() < 1.0
    assert packed.counts.sum() == len(packed) == len(positions)
    assert packed.keys.tolist() == np.unique(pack_places(places)).tolist()


def test_what_is_arranged_stays_as_it_is() -> None:
    positions, normals = _cloud(3_000, 1.0, 0.5)
    arrangement = _arrange(positions)
    once = unpack_points(arrangement, pack_points(arrangement, positions, normals))
    twice = unpack_points(arrangement, pack_points(arrangement, *once))
    assert [a.tobytes() for a in once] == [a.tobytes() for a in twice]


def test_the_order_within_a_block_is_that_of_the_points() -> None:
    positions = np.array([[0.0, 0, 0], [63.0, 0, 0], [0.5, 0, 0], [0.25, 0, 0], [62.9, 0, 0]])
    arrangement = _arrange(positions)
    packed = pack_points(arrangement, positions, positions)
    assert arrangement.edge == 1.0
    assert packed.counts.tolist() == [3, 2]
    unpacked = unpack_points(arrangement, packed)[0][:3, 0]
    np.testing.assert_allclose(unpacked, [0.0, 0.5, 0.25], atol=1e-6)


def test_one_place_cannot_be_arranged() -> None:
    with pytest.raises(InputError, match="one place"):
        choose_arrangement(np.ones(3), np.ones(3))
