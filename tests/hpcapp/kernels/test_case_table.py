"""The table is proved here: whatever the signs, neighbouring cells fit together."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from hpcapp.geometry.lattice import OCTANTS
from hpcapp.kernels.case_table import EDGES, case_triangles, triangle_counts

CASES = range(256)


def middle_of(edge: int) -> tuple[int, ...]:
    """Twice the middle of an edge: integers, so that faces can be told exactly."""
    axis, corner = EDGES[edge]
    return tuple(int(2 * v) + (a == axis) for a, v in enumerate(OCTANTS[corner]))


def faces_of(edge: int) -> set[tuple[int, int]]:
    return {(a, v) for a, v in enumerate(middle_of(edge)) if v in (0, 2)}


def half_edges(case: int) -> Counter[tuple[int, int]]:
    triangles = case_triangles()[case][: triangle_counts()[case]]
    return Counter((int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3))


def segments_of(case: int) -> set[tuple[int, int]]:
    """Half-edges without their opposite: what the cell leaves open on its faces."""
    sides = half_edges(case)
    return {side for side in sides if side[::-1] not in sides}


def crossed_edges(case: int) -> set[int]:
    return {e for e, (a, c) in enumerate(EDGES) if (case >> c & 1) != (case >> (c | 1 << a) & 1)}


def test_triangles_use_exactly_the_crossed_edges() -> None:
    for case in CASES:
        assert {edge for side in half_edges(case) for edge in side} == crossed_edges(case)


def test_what_a_cell_leaves_open_lies_in_its_faces_and_nothing_else_does() -> None:
    for case in CASES:
        sides = half_edges(case)
        assert set(sides.values()) <= {1}
        for first, second in sides:
            in_a_face = bool(faces_of(first) & faces_of(second))
            assert in_a_face == ((second, first) not in sides)


def test_neighbours_agree_on_every_face_whatever_their_other_corners_are() -> None:
    seen: dict[tuple[int, int, tuple[int, ...]], frozenset[Any]] = {}
    for case in CASES:
        for axis in range(3):
            for side in (0, 2):
                drawn = face_drawing(case, axis, side)
                pattern = face_pattern(case, axis, side)
                assert seen.setdefault((axis, side, pattern), drawn) == drawn
    for (axis, side, pattern), drawn in seen.items():
        opposite = seen[axis, 2 - side, pattern]
        assert drawn == frozenset(segment[::-1] for segment in opposite)


def face_pattern(case: int, axis: int, side: int) -> tuple[int, ...]:
    return tuple(case >> c & 1 for c in range(8) if OCTANTS[c][axis] == side // 2)


def face_drawing(
    case: int, axis: int, side: int
) -> frozenset[tuple[tuple[int, ...], tuple[int, ...]]]:
    def flat(edge: int) -> tuple[int, ...]:
        return tuple(v for a, v in enumerate(middle_of(edge)) if a != axis)

    return frozenset(
        (flat(first), flat(second))
        for first, second in segments_of(case)
        if {(axis, side)} & faces_of(first) & faces_of(second)
    )


def test_every_loop_passes_an_edge_once() -> None:
    """With disc-shaped loops this makes the mesh vertex-manifold."""
    for case in CASES:
        leaving = Counter(first for first, _ in segments_of(case))
        assert set(leaving.values()) <= {1}


def test_ambiguous_faces_cut_off_the_inside_corners() -> None:
    corners_on_a_diagonal = 0b1001  # corners 0 and 3, of the face z = 0
    drawn = face_drawing(corners_on_a_diagonal, 2, 0)
    assert {frozenset(segment) for segment in drawn} == {
        frozenset({(1, 0), (0, 1)}),
        frozenset({(2, 1), (1, 2)}),
    }


def test_triangles_turn_anticlockwise_as_seen_from_outside() -> None:
    inside_corner = 1
    triangle = [np.array(middle_of(int(e))) for e in case_triangles()[inside_corner][0]]
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    assert (normal > 0).all()


def test_no_triangles_without_a_change_of_sign() -> None:
    assert triangle_counts()[[0, 255]].tolist() == [0, 0]
    assert (case_triangles()[triangle_counts().argmax()] >= 0).all(), "the table has no spare row"
