"""A mesh that is cut ends on the border, keeps what is within, and gets no other holes."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.clipping import clip_mesh, find_beyond
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.geometry.region import Region

BOX = Region.box(np.array([0.9, 0.2, 2.0]), np.array([-0.5, -0.3, -0.21]))
BALL = Region.ball(np.array([0.5, 0.1, 0.0]), 0.7)


def sphere() -> tuple[FloatArray, IntArray]:
    """An octahedron whose faces are halved five times, on the unit sphere; some corners on axes."""
    vertices = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    faces = np.array(
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    )
    for _ in range(5):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        distinct, which = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = (len(vertices) + which.reshape(-1, 3)).T
        vertices = np.concatenate([vertices, vertices[distinct].mean(axis=1)])
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
        a, b, c = faces.T
        rows = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.concatenate([np.stack(row, axis=1) for row in rows])
    return vertices, faces


def area(vertices: FloatArray, faces: IntArray) -> float:
    a, b, c = (vertices[column] for column in faces.T)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("region", [BOX, BALL], ids=["box", "ball"])
def test_what_is_left_and_what_is_cut_off_are_the_whole(region: Region) -> None:
    vertices, faces = sphere()
    cut, rest = clip_mesh(vertices, faces, region)
    wide = region.widen(1e-9)
    assert wide.find(cut).all()
    assert len(np.unique(cut, axis=0)) == len(cut)
    topology = check_mesh(Mesh(cut, rest))
    assert topology.edge_manifold
    assert topology.vertex_manifold
    # The faces keep their side: the cone from the middle to each is positive.
    assert (np.linalg.det(cut[rest]) > -1e-15).all()
    random = np.random.default_rng(0)
    corners = random.dirichlet((1, 1, 1), size=200_000)
    a, b, c = (vertices[column] for column in faces.T)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = random.choice(len(faces), 200_000, p=areas / areas.sum())
    places = np.einsum("nk,nkd->nd", corners, vertices[faces[chosen]])
    share = region.find(places).mean()
    assert area(cut, rest) == pytest.approx(share * areas.sum() / 2, rel=0.02)


def test_a_cap_has_the_area_of_a_cap() -> None:
    vertices, faces = sphere()
    far = np.full(3, 5.0)
    cut, rest = clip_mesh(vertices, faces, Region.box(np.array([-5.0, -5.0, 0.4]), far))
    assert area(cut, rest) == pytest.approx(2 * np.pi * 0.6, rel=2e-3)
    assert (cut[:, 2] >= 0.4).all()
    border = cut[np.abs(cut[:, 2] - 0.4) < 1e-6]
    assert (border[:, 2] == 0.4).all()
    assert check_mesh(Mesh(cut, rest)).boundaries == 1


def test_a_mesh_within_is_as_it_was_and_one_beyond_is_gone() -> None:
    vertices, faces = sphere()
    cut, rest = clip_mesh(vertices, faces, Region.ball(np.zeros(3), 2.0))
    assert np.array_equal(cut, vertices)
    assert np.array_equal(rest, faces)
    cut, rest = clip_mesh(vertices, faces, Region.ball(np.zeros(3), 0.5))
    assert not len(cut)
    assert not len(rest)


def test_a_plane_through_vertices_makes_no_faces_without_area() -> None:
    vertices, faces = sphere()  # many vertices are on z = 0
    far = np.full(3, 5.0)
    cut, rest = clip_mesh(vertices, faces, Region.box(np.array([-5.0, -5.0, 0.0]), far))
    assert len(rest) == len(faces) // 2
    assert check_mesh(Mesh(cut, rest)).boundaries == 1


def test_faces_beyond_one_side_are_known_by_their_corners() -> None:
    beyond = find_beyond(np.array([[0.0, 0, 0], [2, 0, 0], [-2, 0, 0], [2, 0, 9]]), BOX)
    assert beyond[0] == 0
    assert not beyond[1] & beyond[2]
    assert beyond[1] & beyond[3]
