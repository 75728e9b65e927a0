"""Light meshes: close to the original, as closed and manifold as it, and the same each time."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from level_sets import mesh_level_set
from scipy.spatial import cKDTree

from hpcapp.applications.surface.stitching.topology import check_mesh, signed_volume
from hpcapp.geometry.mesh import Mesh
from hpcapp.simplification.mesh import simplify_mesh
from hpcapp.simplification.parts import collapse
from hpcapp.simplification.target import Target
from hpccomponent.errors import UsageError


def make_torus(cells: int = 64) -> Mesh:
    """A torus of radii 1 and 0.4, by its distance on a grid of so many cells."""
    return mesh_level_set(lambda x, y, z: np.hypot(np.hypot(x, y) - 1.0, z) - 0.4, 1.6, cells)


def distance(vertices: np.ndarray) -> np.ndarray:
    """How far places are from the true torus."""
    radius = np.hypot(vertices[:, 0], vertices[:, 1]) - 1.0
    return np.asarray(np.abs(np.hypot(radius, vertices[:, 2]) - 0.4))


def test_a_tenth_of_the_faces_is_close_and_closed() -> None:
    mesh = make_torus()
    light = simplify_mesh(mesh, Target(faces=len(mesh.faces) // 10))
    assert len(light.faces) <= len(mesh.faces) // 10
    found = check_mesh(light)
    assert found.watertight
    assert found.outward
    assert (found.components, found.genus) == (1, 1)
    centres = light.vertices[light.faces].mean(axis=1)
    voxel = 3.2 / 63
    assert max(distance(light.vertices).max(), distance(centres).max()) < 0.5 * voxel
    assert signed_volume(light) == pytest.approx(2 * np.pi**2 * 0.4**2, rel=0.01)


@pytest.mark.parametrize("faces", [400, 200, 40])
def test_a_thin_neck_is_not_pinched(faces: int) -> None:
    """Two balls joined by a thin neck: collapses would pinch it."""

    def field(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        left, right = (np.hypot(np.hypot(x + at, y), z) - 0.4 for at in (0.45, -0.45))
        neck = np.maximum(np.hypot(y, z) - 0.05, np.abs(x) - 0.4)
        return np.asarray(np.minimum(np.minimum(left, right), neck))

    mesh = mesh_level_set(field, 1.0, 48)
    assert check_mesh(mesh).watertight
    light = simplify_mesh(mesh, Target(faces=faces))
    assert check_mesh(light).watertight
    assert len(light.faces) < len(mesh.faces)
    corners = np.sort(light.faces, axis=1)
    assert len(np.unique(corners, axis=0)) == len(corners)  # no two faces back to back


def test_a_tolerance_is_kept_and_used() -> None:
    mesh = make_torus()
    counts = []
    for tolerance in (0.002, 0.01):
        light = simplify_mesh(mesh, Target(tolerance=tolerance))
        counts.append(len(light.faces))
        assert check_mesh(light).watertight
        moved = distance(light.vertices[light.faces].mean(axis=1)).max()
        assert moved < tolerance + distance(mesh.vertices).max() + 0.001  # chords of a curved face
    assert counts[1] < counts[0] < len(mesh.faces)


def test_an_edge_stays_sharp() -> None:
    box = mesh_level_set(
        lambda x, y, z: np.maximum(np.maximum(np.abs(x), np.abs(y)), np.abs(z)) - 1.0, 1.2, 25
    )
    light = simplify_mesh(box, Target(600))
    assert check_mesh(light).watertight
    assert np.isclose(light.vertices.min(axis=0), -1.0).all()
    assert np.isclose(light.vertices.max(axis=0), 1.0).all()


def halve(mesh: Mesh) -> Mesh:
    """The upper half of a mesh, open below."""
    half = mesh.faces[mesh.vertices[mesh.faces][:, :, 2].mean(axis=1) > 0]
    used, rows = np.unique(half, return_inverse=True)
    return Mesh(mesh.vertices[used], rows.reshape(-1, 3))


def find_border(mesh: Mesh) -> np.ndarray:
    """The ends of the edges of one face, shape (b, 2, 3)."""
    sides = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, first, counts = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.asarray(mesh.vertices[sides[first[counts == 1]]])


def test_a_boundary_keeps_its_shape() -> None:
    half = halve(make_torus(40))
    light = simplify_mesh(half, Target(faces=len(half.faces) // 10))
    found, before = check_mesh(light), check_mesh(half)
    assert found.edge_manifold
    assert found.vertex_manifold
    assert found.boundaries == before.boundaries == 2
    assert found.boundary_edges < 0.7 * before.boundary_edges
    voxel = 3.2 / 39
    rings = find_border(light).mean(axis=1)
    near, _ = cKDTree(find_border(half).mean(axis=1)).query(rings)
    assert near.max() < voxel


def test_a_boundary_that_others_share_stays_as_it_is() -> None:
    half = halve(make_torus(40))
    light, _ = collapse(half, Target(faces=len(half.faces) // 4), keeps_border=True)
    before, after = (np.sort(find_border(one).reshape(-1, 6), axis=0) for one in (half, light))
    np.testing.assert_array_equal(before, after)


def join(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def test_each_place_pays_by_its_error() -> None:
    """A wrinkled ball beside a smooth one of as many faces: the wrinkles keep theirs."""

    def wrinkled(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        bumps = 0.05 * np.sin(12 * x) * np.sin(12 * y) * np.sin(12 * z)
        return np.asarray(np.hypot(np.hypot(x, y), z) - 1.0 + bumps)

    smooth = mesh_level_set(lambda x, y, z: np.hypot(np.hypot(x, y), z) - 1.0, 1.3, 40)
    rough = mesh_level_set(wrinkled, 1.3, 40)
    both = join(smooth, replace(rough, vertices=rough.vertices + np.array([4.0, 0.0, 0.0])))
    light = simplify_mesh(both, Target(faces=3000))
    assert 2999 <= len(light.faces) <= 3000
    is_rough = light.vertices[light.faces][:, :, 0].mean(axis=1) > 2.0
    assert 500 < len(light.faces) - is_rough.sum() < 0.7 * is_rough.sum()
    assert check_mesh(light).watertight


def test_crumbs_go_where_the_count_asks_for_it(caplog: pytest.LogCaptureFixture) -> None:
    ball = mesh_level_set(lambda x, y, z: np.hypot(np.hypot(x, y), z) - 1.0, 1.3, 24)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.01
    turns = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    crumbs = [Mesh(corners + np.array([2.0 + 0.1 * at, 0.0, 0.0]), turns) for at in range(100)]
    mesh = join(ball, *crumbs)
    caplog.set_level(logging.INFO, "hpcapp")
    light = simplify_mesh(mesh, Target(faces=200))
    assert 197 <= len(light.faces) <= 200
    assert check_mesh(light).watertight
    assert check_mesh(simplify_mesh(mesh, Target(tolerance=0.5))).components == 101
    dropped = 101 - check_mesh(light).components
    assert f"dropped {dropped} closed piece(s)" in caplog.text


def test_what_is_no_manifold_is_left_alone() -> None:
    """Three sheets at one edge, two cones at one tip, a face twice, one without area, a NaN."""
    half = halve(make_torus(24))
    centre = half.vertices[half.faces[7]].mean(axis=0) + np.array([0.0, 0.0, 0.5])
    count = len(half.vertices)
    extra = np.array([centre, centre + 1.0, [np.nan, 0.0, 0.0], centre + 2.0])
    faces: list[Any] = [
        half.faces,
        [[half.faces[9][0], half.faces[9][1], count]],
        [[half.faces[40][0], count + 1, count + 3]],
        half.faces[80:81],
        [[half.faces[90][0], half.faces[90][0], half.faces[90][1]]],
        [[count, count + 1, count + 2]],
    ]
    mesh = Mesh(np.concatenate([half.vertices, extra]), np.concatenate(faces).astype(np.int64))
    light = simplify_mesh(mesh, Target(faces=len(half.faces) // 2))
    assert len(light.faces) <= len(half.faces) // 2
    kept = {tuple(row) for row in light.vertices.tolist()}
    for corner in (*half.vertices[half.faces[9][:2]], *half.vertices[half.faces[80]]):
        assert tuple(corner.tolist()) in kept


@pytest.mark.parametrize("shift", [1e6, 1e9])
def test_a_vertex_far_off_costs_nothing(shift: float) -> None:
    mesh = make_torus(40)
    far = mesh.vertices.copy()
    far[0, 1] = shift
    light = simplify_mesh(Mesh(far, mesh.faces), Target(faces=len(mesh.faces) // 4))
    assert len(light.faces) <= len(mesh.faces) // 4
    assert check_mesh(light).edge_manifold
    near = light.vertices[np.abs(light.vertices).max(axis=1) < 2.0]
    assert np.sort(distance(near))[-10] < 0.02  # all but those at the spike


def test_what_vertices_carry_stays_where_it_was() -> None:
    mesh = make_torus(40)
    shade = (mesh.vertices[:, 2] > 0).astype(np.uint8) * 255
    painted = replace(
        mesh,
        origin=np.array([4e5, 5e6, 0.0]),
        normals=mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True),
        colours=np.stack([shade] * 3, axis=1),
        attributes={"height": mesh.vertices[:, 2]},
    )
    light = simplify_mesh(painted, Target(faces=len(mesh.faces) // 8))
    assert (light.origin == painted.origin).all()
    assert light.colours is not None
    assert light.normals is not None
    cell = 3.2 / 39
    assert np.abs(light.attributes["height"] - light.vertices[:, 2]).max() < cell
    far = np.abs(light.vertices[:, 2]) > cell
    assert ((light.colours[far, 0] > 0) == (light.vertices[far, 2] > 0)).all()


def test_the_same_mesh_gives_the_same_bits() -> None:
    mesh = make_torus(40)
    first, again = (simplify_mesh(mesh, Target(1000)) for _ in range(2))
    assert (first.vertices == again.vertices).all()
    assert (first.faces == again.faces).all()
    assert simplify_mesh(mesh, Target(len(mesh.faces))) is mesh


def test_wrong_numbers_are_said() -> None:
    with pytest.raises(UsageError, match="faces is 3"):
        Target(faces=3).check()
    with pytest.raises(UsageError, match="tolerance is nan"):
        Target(tolerance=float("nan")).check()
