"""Coordinates from the centre of the earth are told from those of maps, and have an up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from on_earth import find_place

from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.geocentric import find_upright, refuse_geocentric
from hpccomponent.errors import InputError

LATITUDES = st.floats(0.2, 80.0).flatmap(lambda latitude: st.sampled_from((latitude, -latitude)))
CENTRED = Crs("EPSG:4978", "m")


@given(LATITUDES, st.floats(-180.0, 180.0), st.floats(-11_000.0, 9_000.0), st.floats(0.0, 9e4))
def test_up_is_away_from_the_earth(
    latitude: float, longitude: float, height: float, size: float
) -> None:
    place, axes = find_place(latitude, longitude, height)
    upright = find_upright(place - size / 4.0, place + size / 4.0, UNKNOWN)
    assert upright is not None
    assert np.allclose(upright, axes, atol=1e-5)
    assert np.allclose(upright @ upright.T, np.eye(3))


@given(
    st.floats(-1e7, 1e7), st.floats(-1e7, 1e7), st.floats(-9e3, 9e3), st.sampled_from((1, -1)),
    st.booleans(),
)  # fmt: skip
@example(569_000.0, 6_335_000.0, 20.0, -1, True)  # Aberdeen: as far from zero as the equator
@example(3_500_000.0, 5_330_000.0, 600.0, 1, False)
def test_a_map_is_none_whichever_axis_is_its_height(
    east: float, north: float, height: float, sign: int, is_y_up: bool
) -> None:
    if is_y_up:  # in metres from an origin near it
        east *= 0.1
    place = np.array([east, height, sign * north] if is_y_up else [east, north, height])
    assert find_upright(place, place + 100.0, UNKNOWN) is None


@pytest.mark.parametrize(
    ("height", "size", "is_told"),
    [(18e3, 1e3, True), (22e3, 1e3, False), (-22e3, 1e3, False), (0, 9e4, True), (0, 1.1e5, False)],
)
def test_how_high_and_how_wide_it_may_be(height: float, size: float, is_told: bool) -> None:
    place, _ = find_place(48.0, 9.0, height)
    half = np.array([0.0, 0.0, 0.5 * size])
    assert (find_upright(place - half, place + half, UNKNOWN) is not None) == is_told


@pytest.mark.parametrize(("latitude", "longitude"), [(0.0, 40.0), (90.0, 0.0), (-89.0, 10.0)])
def test_at_the_equator_and_the_poles_the_file_has_to_say_it(
    latitude: float, longitude: float
) -> None:
    place, axes = find_place(latitude, longitude, 10.0)
    assert find_upright(place, place, UNKNOWN) is None
    upright = find_upright(place, place, CENTRED)
    assert upright is not None
    assert np.allclose(upright[2], axes[2])


def test_units_count_and_what_is_said_must_fit_the_numbers() -> None:
    place, _ = find_place(48.0, 9.0, 300.0)
    feet = place / 0.3048
    assert find_upright(feet, feet + 1.0, Crs(None, "ft")) is not None
    assert find_upright(feet, feet + 1.0, Crs(None, "m")) is None
    assert find_upright(place, place, Crs(None, "degree")) is None
    assert find_upright(np.zeros(3), np.ones(3), CENTRED) is None  # moved to zero: up is lost
    with pytest.raises(InputError, match=r"a\.laz: .* z is no height; project it to a map"):
        refuse_geocentric("a.laz", place, place, UNKNOWN)
