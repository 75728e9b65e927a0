"""What a summary says of parts that can be counted by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import summarize_part

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
SUPPORTED = np.array([True, False, True, True])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)


def tetrahedron() -> MeshPart:
    """One brick with a closed tetrahedron; six times its volume is 1."""
    counts = (np.array([4], np.int32), np.array([4], np.int32))
    none = (np.empty(0, np.int64), np.empty(0, np.int32))
    return MeshPart(np.array([7]), np.array([False]), *counts, CORNERS, FACES, *none, SUPPORTED)


def cut_tetrahedron() -> MeshPart:
    """Its last vertex belongs to another part."""
    part = replace(
        tetrahedron(),
        vertices=CORNERS[:3],
        supported=SUPPORTED[:3],
        vertex_counts=np.array([3], np.int32),
        faces=np.where(FACES == 3, -1, FACES).astype(np.int32),
    )
    return replace(part, foreign_bricks=np.array([9]), foreign_numbers=np.array([5], np.int32))


def test_supported_vertices_are_counted() -> None:
    assert summarize_part(tetrahedron()).entry_supports.tolist() == [3]
    guest = replace(tetrahedron(), guests=np.array([True]))
    assert summarize_part(guest).entry_supports.tolist() == [3]


def test_nothing_is_open_in_a_closed_part() -> None:
    summary = summarize_part(tetrahedron())
    assert summary.entry_vertices.tolist() == summary.entry_faces.tolist() == [4]
    assert summary.entry_sums[:, :4].tolist() == [[1.0, 1.0, 1.0, 1.0]]
    assert summary.entry_sums[0, 4] == pytest.approx(1.5 + 0.75**0.5)
    assert summary.bounds.tolist() == [[0, 0, 0, 1, 1, 1]]
    assert not len(summary.piece_vertices)
    assert not len(summary.sides)
    assert not len(summary.rim)


def test_a_foreign_vertex_is_open_and_closes_the_others() -> None:
    summary = summarize_part(cut_tetrahedron())
    assert summary.piece_vertices.tolist() == [-1]  # one ring of corners at it
    assert not len(summary.sides)
    assert summary.seam_faces.tolist() == [[1, 0, 1, -1], [2, 1, 2, -1], [3, 2, 0, -1]]
    assert summary.rim.tolist() == [0, 1, 2]
    assert summary.rim_places.tolist() == CORNERS[:3].tolist()
    assert summary.foreign_labels.tolist() == [0]


def test_around_a_hole_the_sides_are_loose() -> None:
    part = tetrahedron()
    holed = replace(part, faces=FACES[1:], face_counts=np.array([3], np.int32))
    summary = summarize_part(holed)
    assert summary.piece_vertices.tolist() == [0, 1, 2]
    ends = summary.piece_vertices[summary.sides[:, 1:]]
    assert {tuple(end) for end in ends.tolist()} == {(0, 1), (1, 2), (2, 0)}


def test_a_guest_is_a_unit_of_its_own() -> None:
    part = replace(tetrahedron(), guests=np.array([True]))
    summary = summarize_part(part)
    assert not len(summary.piece_vertices)  # it is closed in itself
    two = replace(
        part,
        bricks=np.array([7, 8]),
        guests=np.array([False, True]),
        vertex_counts=np.array([4, 0], np.int32),
        face_counts=np.array([2, 2], np.int32),
    )
    summary = summarize_part(two)
    assert set(summary.piece_units.tolist()) == {-1, 1}
    assert len(summary.sides) == 12  # all sides of both units


def test_a_vertex_that_no_face_uses_is_bare() -> None:
    part = replace(tetrahedron(), faces=FACES[:1], face_counts=np.array([1], np.int32))
    assert summarize_part(part).bare.tolist() == [3]


def test_bricks_with_two_components_name_them_for_each_vertex() -> None:
    part = tetrahedron()
    twice = replace(
        part,
        vertices=np.concatenate([CORNERS, CORNERS + 5.0]),
        supported=np.concatenate([SUPPORTED, SUPPORTED]),
        faces=np.concatenate([FACES, FACES + 4]).astype(np.int32),
        vertex_counts=np.array([8], np.int32),
        face_counts=np.array([8], np.int32),
    )
    summary = summarize_part(twice)
    assert summary.mixed_labels.tolist() == [0] * 4 + [1] * 4
    assert summary.entry_supports.tolist() == [3, 3]
    assert summary.entry_labels.tolist() == [0, 1]
    assert summary.entry_faces.tolist() == [4, 4]
