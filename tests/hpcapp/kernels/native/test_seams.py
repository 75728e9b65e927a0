"""The seams and sums of parts: native and numpy agree, whatever the faces are."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.kernels import portable
from hpcapp.kernels.types.brick_mesh import BrickSums, Seams


@st.composite
def random_parts(draw: st.DrawFn) -> dict[str, object]:
    """Faces without any order, over few enough nodes that all kinds of rings and knots come up."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    own, foreign, twins = draw(st.integers(1, 12)), draw(st.integers(0, 3)), draw(st.integers(0, 4))
    vertices = own + foreign
    faces = rng.integers(-foreign, vertices + twins, (draw(st.integers(0, 30)), 3))
    if draw(st.booleans()) and len(faces):  # close it: each face once more, turned round
        faces = np.concatenate([faces, faces[:, ::-1]])
    bricks = draw(st.integers(1, 5))
    vertex_of = np.concatenate([np.arange(vertices), rng.integers(0, vertices, twins)])
    return {
        "faces": faces.astype(np.int32),
        "counts": (own, foreign),
        "vertex_of": vertex_of.astype(np.int32),
        "is_open": rng.random(vertices + twins) < 0.3,
        "vertices": rng.normal(size=(own, 3)),
        "of_vertex": np.bincount(rng.integers(0, bricks, own), minlength=bricks).astype(np.int32),
        "of_face": np.bincount(rng.integers(0, bricks, len(faces)), minlength=bricks).astype(
            np.int32
        ),
    }


@given(random_parts())
@settings(max_examples=300)
def test_seams(native: ModuleType, part: dict[str, Any]) -> None:
    arguments = (part["faces"], part["vertex_of"], part["is_open"])
    expected = portable.find_seams(arguments[0], part["counts"], *arguments[1:])
    found = native.find_seams(arguments[0], part["counts"], *arguments[1:])
    assert isinstance(found, Seams)
    assert found.components == expected.components
    for name in ("labels", "pieces", "sides", "bare"):
        theirs, ours = getattr(found, name), getattr(expected, name)
        assert theirs.dtype == ours.dtype
        np.testing.assert_array_equal(theirs, ours, err_msg=name)


@given(random_parts())
@settings(max_examples=100)
def test_sums(native: ModuleType, part: dict[str, Any]) -> None:
    own, foreign = part["counts"]
    faces = np.clip(part["faces"], -foreign, own - 1).astype(np.int32)
    labels = np.random.default_rng(own).integers(0, 3, own + foreign).astype(np.int32)
    labels[0] = 2
    counts = (part["of_vertex"], part["of_face"])
    rest = (labels, 3)
    if len(labels) < 3:
        return
    expected = portable.sum_bricks(part["vertices"], faces, counts, *rest)
    found = native.sum_bricks(part["vertices"], faces, counts, *rest)
    assert isinstance(found, BrickSums)
    for name in ("starts", "labels", "vertices", "faces", "bounds"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    np.testing.assert_allclose(found.sums, expected.sums, rtol=1e-12, atol=1e-12)


def test_faces_that_name_no_vertex_are_refused(native: ModuleType) -> None:
    vertex_of, is_open = np.arange(3, dtype=np.int32), np.zeros(3, bool)
    for face in ([0, 1, 3], [0, 1, -2]):
        faces = np.array([face], np.int32)
        with pytest.raises(ValueError, match="not there"):
            native.find_seams(faces, (2, 1), vertex_of, is_open)
