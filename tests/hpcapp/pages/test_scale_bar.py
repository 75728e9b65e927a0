"""The scale bar: round lengths, true ones, and where there is room for it."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.pages.drawing.camera import look_along
from hpcapp.pages.drawing.scale_bar import add_scale_bar, choose_length, name_length
from hpcapp.pages.render import draw_mesh


@pytest.mark.parametrize("scale", [3e-7, 0.02, 1.0, 37.0, 5e5])
def test_lengths_are_round_and_take_a_tenth_to_a_quarter_of_the_width(scale: float) -> None:
    length = choose_length(scale, 800)
    assert 0.099 <= length * scale / 800 <= 0.2501
    assert f"{length:.6e}"[0] in "125"
    assert f"{length:.6e}"[1:8] == ".000000"


@pytest.mark.parametrize(
    ("length", "unit", "text"),
    [
        (0.005, "m", "5 mm"),
        (0.1, "m", "10 cm"),
        (50.0, "mm", "5 cm"),
        (1e4, "m", "10 km"),
        (2000.0, "US ft", "2,000 US ft"),
        (0.001, "degree", "0.001 degree"),
        (20.0, None, "20 units"),
    ],
)
def test_lengths_are_said_as_people_say_them(length: float, unit: str | None, text: str) -> None:
    assert name_length(length, unit) == text


def test_the_bar_is_as_long_as_it_says() -> None:
    white = np.full((400, 600, 3), 255, np.uint8)
    picture = add_scale_bar(white, 50.0, "m")  # a quarter is 3 m: the bar shows 2 m
    dark = (picture.astype(int).sum(axis=2) < 300).nonzero()
    longest = max(np.ptp(dark[1][dark[0] == row]) for row in np.unique(dark[0]))
    assert longest == pytest.approx(100, abs=3)


def test_a_small_picture_has_no_bar() -> None:
    white = np.full((64, 64, 3), 255, np.uint8)
    assert np.array_equal(add_scale_bar(white, 1.0, None), white)


def test_a_picture_knows_its_scale() -> None:
    square = Mesh(np.array([[0.0, 0, 0], [0, 4, 0], [0, 4, 4], [0, 0, 4]]), np.array([[0, 1, 2]]))
    _, pixels_per_unit = draw_mesh(square, look_along(0.0, 0.0, "z"), 200, "z")
    assert pixels_per_unit == pytest.approx(0.92 * 200 / 4)
