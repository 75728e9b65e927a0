"""From where a mesh is seen, if nobody says."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.pages.picture import EYE, choose_eye

CUBE = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3) * 1.0
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([face for a, b, c, d in SIDES for face in ((a, b, c), (a, c, d))])


def test_a_closed_mesh_is_seen_from_above() -> None:
    assert choose_eye(Mesh(CUBE, FACES), "z") == EYE
    assert choose_eye(Mesh(CUBE, FACES[:, ::-1]), "z") == EYE


@pytest.mark.parametrize(("up", "axis"), [("z", 0), ("x", 1), ("y", 0)])
def test_a_sheet_is_seen_from_where_its_front_is(up: str, axis: int) -> None:
    """One side of a cube, whose normal points at the eye, or away."""
    is_side = (CUBE[FACES][..., axis] == CUBE[FACES][:, :1, axis]).all(axis=1)
    sheet = FACES[is_side & (CUBE[FACES][:, 0, axis] == 1)]
    assert choose_eye(Mesh(CUBE, sheet), up) == EYE
    assert choose_eye(Mesh(CUBE, sheet[:, ::-1]), up) == (EYE[0] - 180.0, EYE[1])


def test_what_is_turned_down_is_seen_from_below() -> None:
    assert choose_eye(Mesh(CUBE, FACES[8:10]), "z") == (EYE[0], -EYE[1])


@pytest.mark.parametrize(("length", "is_sheet"), [(0.1, False), (0.5, True)])
def test_a_mean_normal_of_some_length_makes_a_sheet(length: float, is_sheet: bool) -> None:
    wide = 0.5 * (1.0 + length)  # of two squares back to back, areas whose difference is the length
    front, back = CUBE * [1, wide, 1], CUBE * [1, 1.0 - wide, 1]
    mesh = Mesh(np.concatenate([front, back]), np.concatenate([FACES[:2], FACES[:2, ::-1] + 8]))
    expected = EYE[0] - 180.0 if is_sheet else EYE[0]
    assert choose_eye(mesh, "z")[0] == expected
