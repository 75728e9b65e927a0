"""A part of a mesh travels as a tuple of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple

import numpy as np
import pytest

from hpcapp.applications.surface.extraction.parts import MeshPart, join_parts
from hpccomponent.protocol.codec import decode_values, encode_values


def test_a_part_comes_off_the_wire_as_it_went_on() -> None:
    part = MeshPart(
        np.array([5, 9]),
        np.array([False, True]),
        np.array([2, 0], np.int32),
        np.array([1, 0], np.int32),
        np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]),
        np.array([[0, 1, -1]], np.int32),
        np.array([7]),
        np.array([3], np.int32),
        np.array([True, False]),
    )
    (back,) = decode_values(*encode_values((part,)))
    assert isinstance(back, MeshPart)
    for sent, received in zip(astuple(part), astuple(back), strict=True):
        assert received.dtype == sent.dtype
        assert np.array_equal(received, sent)


def part(
    bricks: list[int],
    vertices: list[int],
    faces: list[list[int]],
    foreign: Sequence[tuple[int, int]] = (),
) -> MeshPart:
    """Return a part of which every brick has one vertex and, maybe, a face in the first."""
    counts = np.ones(len(bricks), np.int32)
    of_faces = np.zeros(len(bricks), np.int32)
    of_faces[:1] = len(faces)
    names = np.array(foreign, np.int64).reshape(-1, 2)
    return MeshPart(
        np.array(bricks),
        np.array(bricks) % 2 == 1,
        counts,
        of_faces,
        np.array(vertices, float)[:, None] * np.ones(3),
        np.array(faces, np.int32).reshape(-1, 3),
        names[:, 0],
        names[:, 1].astype(np.int32),
        np.array(vertices) % 2 == 0,
    )


def same(one: MeshPart, other: MeshPart) -> bool:
    pairs = zip(astuple(one), astuple(other), strict=True)
    return all(a.dtype == b.dtype and np.array_equal(a, b) for a, b in pairs)


@pytest.mark.parametrize("swap", [False, True])
def test_joined_parts_are_one(swap: bool) -> None:
    """Their bricks alternate; one foreign vertex is the other's, two are foreign to both."""
    first = part([2, 6], [2, 6], [[0, 1, ~0], [1, ~1, ~2]], [(4, 0), (9, 1), (9, 5)])
    second = part([4, 8], [4, 8], [[0, ~1, 1], [0, 1, ~0]], [(1, 7), (9, 1)])
    joined = join_parts([second, first] if swap else [first, second])
    expected = part(
        [2, 4, 6, 8], [2, 4, 6, 8], [[0, 2, 1], [2, ~1, ~2], [1, ~1, 3], [1, 3, ~0]],
        [(1, 7), (9, 1), (9, 5)],
    )  # fmt: skip
    expected.face_counts[:] = [2, 2, 0, 0]
    assert same(joined, expected)


def test_parts_that_need_nothing_of_one_another_lie_side_by_side() -> None:
    joined = join_parts([part([3, 4], [3, 4], []), part([0, 5], [0, 5], [])])
    assert same(joined, part([0, 3, 4, 5], [0, 3, 4, 5], []))
    one = part([3], [3], [[0, ~0, ~1]], [(7, 0), (7, 1)])
    assert join_parts([one]) is one
    assert same(join_parts([one, MeshPart.empty()]), one)
    assert same(join_parts([]), MeshPart.empty())


def test_parts_whose_foreign_vertices_are_all_theirs_have_none_left() -> None:
    first = part([0], [0], [[0, ~0, ~1]], [(1, 0), (2, 0)])
    joined = join_parts([first, part([1, 2], [1, 2], [])])
    assert same(joined, part([0, 1, 2], [0, 1, 2], [[0, 1, 2]]))
