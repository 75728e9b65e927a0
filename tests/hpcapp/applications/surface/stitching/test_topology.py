"""check_mesh against meshes whose topology is known."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.stitching.topology import check_mesh, require_closed, signed_volume
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import IntArray
from hpccomponent.errors import JobError


def grid_torus(
    rows: int, columns: int, center: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Mesh:
    """A torus of rows x columns quads, split in two: genus 1, faces outwards."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    u, v = 2 * np.pi * i.ravel() / rows, 2 * np.pi * j.ravel() / columns
    radius = 1.0 + 0.4 * np.cos(v)
    vertices = np.stack([radius * np.cos(u), radius * np.sin(u), 0.4 * np.sin(v)], axis=1)

    def number(a: IntArray, b: IntArray) -> IntArray:
        return (a % rows) * columns + b % columns

    a, b, c, d = (number(i + p, j + q).ravel() for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Mesh(vertices + center, faces)


def tetrahedron(shift: float = 0.0) -> Mesh:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + shift
    return Mesh(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]))


def join(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=True)]),
    )


def test_a_tetrahedron_is_a_closed_sphere() -> None:
    found = check_mesh(tetrahedron())
    assert found.watertight
    assert found.oriented
    assert found.outward
    assert (found.components, found.genus, found.vertices, found.faces) == (1, 0, 4, 4)


def test_a_torus_has_one_handle() -> None:
    found = check_mesh(grid_torus(24, 12))
    assert found.watertight
    assert (found.components, found.genus) == (1, 1)


def test_components_are_counted_and_listed_by_size() -> None:
    found = check_mesh(join(tetrahedron(), grid_torus(24, 12, (5, 0, 0)), tetrahedron(9.0)))
    assert found.components == 3
    assert found.component_genus == (1, 0, 0)
    assert found.genus == 1


def test_a_hole_leaves_boundary_edges_and_no_genus() -> None:
    whole = grid_torus(24, 12)
    found = check_mesh(Mesh(whole.vertices, whole.faces[1:]))
    assert not found.watertight
    assert found.boundary_edges == 3
    assert found.genus is None
    assert found.edge_manifold
    assert found.vertex_manifold


def test_a_third_face_on_an_edge_is_not_edge_manifold() -> None:
    mesh = tetrahedron()
    vertices = np.concatenate([mesh.vertices, [[1.0, 1.0, -1.0]]])
    found = check_mesh(Mesh(vertices, np.concatenate([mesh.faces, [[0, 1, 4]]])))
    assert not found.edge_manifold
    assert not found.watertight


def test_two_pieces_that_meet_in_a_vertex_are_not_vertex_manifold() -> None:
    pair = join(tetrahedron(), tetrahedron(3.0))
    found = check_mesh(Mesh(pair.vertices, np.where(pair.faces == 4, 3, pair.faces)))
    assert found.edge_manifold
    assert not found.vertex_manifold
    assert not found.watertight
    assert found.components == 1


def test_one_turned_face_is_not_oriented() -> None:
    mesh = tetrahedron()
    faces = mesh.faces.copy()
    faces[0] = faces[0, ::-1]
    found = check_mesh(Mesh(mesh.vertices, faces))
    assert found.watertight
    assert not found.oriented


def test_faces_that_look_inwards_enclose_a_negative_volume() -> None:
    mesh = tetrahedron()
    inside_out = Mesh(mesh.vertices, mesh.faces[:, ::-1])
    assert check_mesh(inside_out).oriented
    assert not check_mesh(inside_out).outward
    assert signed_volume(inside_out) == -signed_volume(mesh)


def test_a_collapsed_face_is_not_edge_manifold() -> None:
    mesh = tetrahedron()
    found = check_mesh(Mesh(mesh.vertices, np.concatenate([mesh.faces, [[0, 0, 1]]])))
    assert not found.edge_manifold


def test_vertices_without_faces_do_not_count() -> None:
    mesh = tetrahedron()
    padded = Mesh(np.concatenate([np.zeros((7, 3)), mesh.vertices]), mesh.faces + 7)
    assert check_mesh(padded) == check_mesh(mesh)


def test_an_empty_mesh_is_not_watertight() -> None:
    found = check_mesh(Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)))
    assert not found.watertight
    assert (found.components, found.faces, found.genus) == (0, 0, None)


def test_the_volume_survives_a_distant_frame() -> None:
    far = Mesh(tetrahedron().vertices + 4e6, tetrahedron().faces)
    assert signed_volume(far) == pytest.approx(1 / 6, rel=1e-8)


def test_the_order_of_faces_and_the_names_of_vertices_do_not_matter() -> None:
    mesh = join(grid_torus(24, 12), tetrahedron(5.0))
    rng = np.random.default_rng(3)
    names = rng.permutation(len(mesh.vertices))
    vertices = np.empty_like(mesh.vertices)
    vertices[names] = mesh.vertices
    shuffled = Mesh(vertices, names[mesh.faces][rng.permutation(len(mesh.faces))])
    assert check_mesh(shuffled) == check_mesh(mesh)


def test_a_closed_mesh_that_was_opened_does_not_pass() -> None:
    whole = grid_torus(24, 12)
    closed, opened = check_mesh(whole), check_mesh(Mesh(whole.vertices, whole.faces[1:]))
    assert require_closed(lambda: closed, closed) is closed
    assert require_closed(lambda: opened, opened) is opened
    with pytest.raises(JobError, match="of 575 faces it would not be; leave it more"):
        require_closed(lambda: closed, opened)
