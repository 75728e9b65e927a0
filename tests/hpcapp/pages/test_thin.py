"""Copies with fewer faces: near the mesh, small enough, and of the same colours."""

from __future__ import annotations

import numpy as np
from level_sets import mesh_level_set

from hpcapp.geometry.mesh import Mesh
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.pages.thin import gather_mesh, thin_mesh


def make_ball(cells: int = 90) -> Mesh:
    """Return a sphere of radius 1 around (5, 0, 0), red where x > 5, with a label by halves."""
    ball = mesh_level_set(lambda *at: np.linalg.norm(at, axis=0) - 1.0, 1.2, cells)
    return Mesh(
        ball.vertices + np.array([5.0, 0.0, 0.0]), ball.faces, np.array([7.0, 0.0, 0.0]),
        colours=((ball.vertices[:, :1] > 0) * np.array([[200, 0, 0]])).astype(np.uint8),
        attributes={"half": (ball.vertices[:, 2] > 0).astype(np.int32)},
    )  # fmt: skip


def test_a_small_mesh_stays_itself() -> None:
    ball = make_ball(10)
    assert thin_mesh(ball, len(ball.faces)) is ball


def test_a_copy_has_fewer_faces_near_the_surface() -> None:
    ball = make_ball()
    thin = thin_mesh(ball, 4000)
    assert 500 < len(thin.faces) <= 4000
    lengths = np.linalg.norm(thin.vertices - [5.0, 0.0, 0.0], axis=1)
    assert np.abs(lengths - 1.0).max() < 0.05
    assert (thin.origin == ball.origin).all()
    assert thin.faces.max() == len(thin.vertices) - 1
    corners = thin.vertices[thin.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = np.einsum("ij,ij->i", normals, corners.mean(axis=1) - [5.0, 0.0, 0.0])
    assert (outward > 0).mean() > 0.99
    area = 0.5 * np.linalg.norm(normals, axis=1).sum()
    assert abs(area / (4 * np.pi) - 1.0) < 0.05


def test_a_copy_keeps_colours_and_labels() -> None:
    thin = thin_mesh(make_ball(), 4000)
    assert thin.colours is not None
    x, z = thin.vertices[:, 0] - 5.0, thin.vertices[:, 2]
    assert (thin.colours[x > 0.1, 0] == 200).all()
    assert (thin.colours[x < -0.1] == 0).all()
    half = thin.attributes["half"]
    assert half.dtype == np.int32
    assert (half[z > 0.1] == 1).all()
    assert (half[z < -0.1] == 0).all()


def test_blocks_are_gathered_in_their_order() -> None:
    ball = make_ball()
    back = gather_mesh(as_stream(ball))
    np.testing.assert_array_equal(back.vertices, ball.vertices)
    np.testing.assert_array_equal(back.faces, ball.faces)
    assert back.colours is not None
    np.testing.assert_array_equal(back.attributes["half"], ball.attributes["half"])
