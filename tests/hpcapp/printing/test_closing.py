"""Meshes of anywhere become manifold: seams, faces that are no surface's, holes of any size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cut_mesh import ball, extract_shape

from hpcapp.applications.surface.stitching.topology import check_mesh, signed_volume
from hpcapp.geometry.mesh import Mesh
from hpcapp.mending.pieces import keep_faces
from hpcapp.printing.closing import close_mesh
from hpccomponent.errors import InputError


@pytest.fixture(scope="module")
def sphere() -> Mesh:
    return extract_shape(lambda points: ball(points, (0, 0, 0), 0.8))[0]


def test_a_mesh_that_was_cut_along_seams_is_one_again(sphere: Mesh) -> None:
    torn = Mesh(
        sphere.vertices[sphere.faces].reshape(-1, 3), np.arange(sphere.faces.size).reshape(-1, 3)
    )
    closed = close_mesh(torn)
    assert check_mesh(closed.mesh).watertight
    assert (closed.holes, closed.lids) == (0, 0)
    assert signed_volume(closed.mesh) == pytest.approx(signed_volume(sphere))


def test_faces_that_no_solid_has_are_dropped(sphere: Mesh) -> None:
    """A fin at an edge, a face that is there twice, and one that is none."""
    fin = len(sphere.vertices)
    a, b, c = sphere.faces[100]
    odd = [[a, b, fin], [a, b, c], [a, a, b]]
    spoilt = Mesh(
        np.concatenate([sphere.vertices, [[2.0, 2.0, 2.0]]]),
        np.concatenate([sphere.faces, np.array(odd)]),
    )
    closed = close_mesh(spoilt)
    assert check_mesh(closed.mesh).watertight
    assert signed_volume(closed.mesh) == pytest.approx(signed_volume(sphere), rel=1e-3)


@pytest.mark.parametrize(("top", "lids"), [(0.797, 0), (0.795, 1), (0.5, 1)])
def test_holes_are_closed_small_and_large(sphere: Mesh, top: float, lids: int) -> None:
    """Of the diagonal of the mesh they are .085, .118 and .68."""
    heights = sphere.vertices[sphere.faces][:, :, 2].max(axis=1)
    closed = close_mesh(keep_faces(sphere, heights < top))
    assert check_mesh(closed.mesh).watertight
    assert (closed.holes, closed.lids) == (1, lids)
    cap = np.pi * (0.8 - top) ** 2 * (0.8 - (0.8 - top) / 3)
    assert signed_volume(closed.mesh) == pytest.approx(4 / 3 * np.pi * 0.8**3 - cap, rel=0.02)


def test_what_was_seen_from_inside_is_told(sphere: Mesh) -> None:
    inside = replace(sphere, faces=sphere.faces[:, ::-1])
    turned = close_mesh(inside)
    assert turned.is_inward
    assert signed_volume(turned.mesh) > 0.0
    heights = sphere.vertices[sphere.faces][:, :, 2].max(axis=1)
    room = close_mesh(keep_faces(inside, heights < 0.5))
    assert room.is_inward
    assert check_mesh(room.mesh).boundaries == 1


def test_a_sheet_stays_open(sphere: Mesh) -> None:
    heights = sphere.vertices[sphere.faces][:, :, 2].min(axis=1)
    assert check_mesh(close_mesh(keep_faces(sphere, heights > 0.4)).mesh).boundaries == 1


def test_what_is_no_surface_is_refused() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]])
    fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    with pytest.raises(InputError, match="no surface"):
        close_mesh(Mesh(corners, fan))
    with pytest.raises(InputError, match="no area"):
        close_mesh(Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), fan[:1]))
