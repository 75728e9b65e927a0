"""The box around points."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray

COORDINATES = st.floats(-1e9, 1e9)


@given(arrays(np.float64, st.tuples(st.integers(1, 40), st.just(3)), elements=COORDINATES))
def test_the_box_holds_all_points_and_is_touched_on_each_side(positions: FloatArray) -> None:
    low, high = bound_points(positions)
    assert ((low <= positions) & (positions <= high)).all()
    assert (low == positions).any(axis=0).all()
    assert (high == positions).any(axis=0).all()
