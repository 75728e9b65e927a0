"""A mesh that is cut ends on the border, keeps what is within, and gets no other holes."""

from __future__ import annotations

import numpy as np
import pytest
from clipped_meshes import area, make_sphere, sample

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.geometry.regions.clipping import clip_mesh, find_beyond
from hpcapp.geometry.regions.region import Region

BOX = Region.box(np.array([0.9, 0.2, 2.0]), np.array([-0.5, -0.3, -0.21]))
BALL = Region.ball(np.array([0.5, 0.1, 0.0]), 0.7)


def clip(vertices: FloatArray, faces: IntArray, region: Region) -> tuple[FloatArray, IntArray]:
    mesh = clip_mesh(Mesh(vertices, faces), region)
    return mesh.vertices, mesh.faces


@pytest.mark.parametrize("region", [BOX, BALL], ids=["box", "ball"])
def test_what_is_left_and_what_is_cut_off_are_the_whole(region: Region) -> None:
    vertices, faces = make_sphere()
    cut, rest = clip(vertices, faces, region)
    wide = region.widen(1e-9)
    assert wide.find(cut).all()
    assert len(np.unique(cut, axis=0)) == len(cut)
    topology = check_mesh(Mesh(cut, rest))
    assert topology.edge_manifold
    assert topology.vertex_manifold
    # The faces keep their side: the cone from the middle to each is positive.
    assert (np.linalg.det(cut[rest]) > -1e-15).all()
    places = sample(vertices, faces, 200_000)
    share = region.find(places).mean()
    assert area(cut, rest) == pytest.approx(share * area(vertices, faces), rel=0.02)


def test_a_ball_within_one_face_leaves_a_disc() -> None:
    corners = np.array([[-90.0, -80, 0], [90, -80, 0], [0, 100, 0]])
    cut, rest = clip(corners, np.array([[0, 1, 2]]), Region.ball(np.array([0, 0, 1.8]), 3.0))
    assert area(cut, rest) == pytest.approx(np.pi * 2.4**2, rel=3e-3)
    assert check_mesh(Mesh(cut, rest)).boundaries == 1
    assert check_mesh(Mesh(cut, rest)).edge_manifold


def test_a_cap_has_the_area_of_a_cap() -> None:
    vertices, faces = make_sphere()
    far = np.full(3, 5.0)
    cut, rest = clip(vertices, faces, Region.box(np.array([-5.0, -5.0, 0.4]), far))
    assert area(cut, rest) == pytest.approx(2 * np.pi * 0.6, rel=2e-3)
    assert (cut[:, 2] >= 0.4).all()
    border = cut[np.abs(cut[:, 2] - 0.4) < 1e-6]
    assert (border[:, 2] == 0.4).all()
    assert check_mesh(Mesh(cut, rest)).boundaries == 1


def test_a_mesh_within_is_as_it_was_and_one_beyond_is_gone() -> None:
    vertices, faces = make_sphere()
    cut, rest = clip(vertices, faces, Region.ball(np.zeros(3), 2.0))
    assert np.array_equal(cut, vertices)
    assert np.array_equal(rest, faces)
    cut, rest = clip(vertices, faces, Region.ball(np.zeros(3), 0.5))
    assert not len(cut)
    assert not len(rest)


def test_a_plane_through_vertices_makes_no_faces_without_area() -> None:
    vertices, faces = make_sphere()  # many vertices are on z = 0
    far = np.full(3, 5.0)
    cut, rest = clip(vertices, faces, Region.box(np.array([-5.0, -5.0, 0.0]), far))
    assert len(rest) == len(faces) // 2
    assert check_mesh(Mesh(cut, rest)).boundaries == 1


def test_faces_beyond_one_side_are_known_by_their_corners() -> None:
    beyond = find_beyond(np.array([[0.0, 0, 0], [2, 0, 0], [-2, 0, 0], [2, 0, 9]]), BOX)
    assert beyond[0] == 0
    assert not beyond[1] & beyond[2]
    assert beyond[1] & beyond[3]
