"""Edges collapse to the same bits in both builds, whatever the mesh."""

from __future__ import annotations

from math import inf
from types import ModuleType

import numpy as np
import pytest
from both_builds import assert_alike
from hypothesis import given, settings
from hypothesis import strategies as st


def make_sheet(seed: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    """A rough square of triangles."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.arange(side + 1.0)] * 2))
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = [[first, first + 1, first + side + 2], [first, first + side + 2, first + side + 1]]
    heights = np.random.default_rng(seed).normal(size=len(x))
    return np.stack([x, y, heights], axis=1), np.concatenate(np.transpose(faces, (0, 2, 1)))


@given(
    st.integers(0, 2**32), st.integers(1, 14), st.floats(0.0, 1.0),
    st.sampled_from([inf, 1e-3, 1.0]), st.booleans(),
)  # fmt: skip
@settings(deadline=None, max_examples=40)
def test_sheets(
    native: ModuleType, seed: int, side: int, share: float, limit: float, keeps: bool
) -> None:
    vertices, faces = make_sheet(seed, side)
    assert_alike(native, "collapse_edges", vertices, faces, int(share * len(faces)), limit, keeps)


@given(st.integers(0, 2**32), st.integers(4, 30), st.integers(1, 120), st.booleans())
@settings(deadline=None, max_examples=60)
def test_any_faces(native: ModuleType, seed: int, vertices: int, faces: int, flat: bool) -> None:
    """Non-manifold, degenerate, repeated, not finite."""
    random = np.random.default_rng(seed)
    places = random.normal(size=(vertices, 3))
    places[:, 2] *= not flat
    places[random.integers(0, vertices), 0] = random.choice([0.0, np.nan, np.inf, 1e200])
    assert_alike(
        native,
        "collapse_edges",
        places,
        random.integers(0, vertices, (faces, 3)),
        faces // 4,
        inf,
        False,
    )


def test_messages_name_the_argument(native: ModuleType) -> None:
    vertices, faces = make_sheet(0, 3)
    with pytest.raises(ValueError, match="faces: a vertex that is not there"):
        native.collapse_edges(vertices, faces + 9, 4, inf, False)
    with pytest.raises(ValueError, match="limit: expected"):
        native.collapse_edges(vertices, faces, 4, 0.0, False)
