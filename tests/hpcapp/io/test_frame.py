import numpy as np
import pytest

from hpcapp.io.frame import needs_double, to_local

CUBE = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.25, 0.5, 0.75]])


def test_positions_near_zero_are_left_exactly_as_they_are() -> None:
    local, origin = to_local(CUBE + 3.0)
    assert (local == CUBE + 3.0).all()
    assert (origin == 0).all()


def test_origin_is_the_centre_in_whole_units() -> None:
    local, origin = to_local(CUBE + np.array([5.4e6, 3.2e5, -40.0]))
    assert origin.tolist() == [5400000.0, 320000.0, -40.0]
    assert np.abs(local).max() <= 1.5


def test_millimetres_survive_georeferenced_coordinates() -> None:
    fine = np.arange(300).reshape(-1, 3) * 1e-3 + np.array([4.5e5, 5.4e6, 120.0])
    local, origin = to_local(fine)
    assert np.abs(np.diff(local, axis=0) - 3e-3).max() < 1e-6
    assert (local + origin == fine).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_points_that_are_not_finite_do_not_move_the_frame(bad: float) -> None:
    positions = np.vstack([CUBE + 5.4e6, [[bad, 0.0, 0.0]]])
    local, origin = to_local(positions)
    assert (origin == 5400000.0).all()
    assert np.isfinite(local[:3]).all()


@pytest.mark.parametrize("positions", [np.empty((0, 3)), np.full((2, 3), np.nan)])
def test_no_finite_point_means_no_origin(positions: np.ndarray) -> None:
    local, origin = to_local(positions)
    assert local is positions
    assert (origin == 0).all()


def test_coordinates_whose_diagonal_overflows_stay() -> None:
    huge = np.array([[-1e308, 0.0, 0.0], [1e308, 1e308, 0.0]])
    assert (to_local(huge)[0] == huge).all()
    assert needs_double(huge, np.zeros(3))


def test_float_serves_near_zero_and_double_where_it_would_round() -> None:
    assert not needs_double(CUBE, np.zeros(3))
    assert needs_double(CUBE, np.array([1.0, 0.0, 0.0]))
    assert needs_double(CUBE + 1e4, np.zeros(3))
    assert needs_double(CUBE * 1e-45, np.zeros(3))
