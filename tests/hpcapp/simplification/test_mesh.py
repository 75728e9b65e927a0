"""Light meshes: close to the original, as closed and manifold as it, and the same each time."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from level_sets import mesh_level_set

from hpcapp.applications.surface.stitching.topology import check_mesh, signed_volume
from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.simplification.mesh import Target, simplify_mesh
from hpccomponent.errors import MissingLibraryError, UsageError


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
def test_what_the_library_breaks_is_mended(faces: int) -> None:
    """Two balls joined by a thin neck: collapses pinch it."""

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


def test_a_boundary_stays() -> None:
    mesh = make_torus(40)
    half = mesh.faces[mesh.vertices[mesh.faces][:, :, 2].mean(axis=1) > 0]
    light = simplify_mesh(Mesh(mesh.vertices, half), Target(faces=len(half) // 4))
    found, before = check_mesh(light), check_mesh(Mesh(mesh.vertices, half))
    assert found.edge_manifold
    assert found.vertex_manifold
    assert found.boundary_edges == before.boundary_edges
    used = {tuple(row) for row in mesh.vertices[np.unique(half)].tolist()}
    kept = sum(tuple(row) in used for row in light.vertices.tolist())
    assert kept >= found.boundary_edges


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


def test_wrong_numbers_and_a_missing_library_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="faces is 3"):
        Target(faces=3).check()
    with pytest.raises(UsageError, match="tolerance is nan"):
        Target(tolerance=float("nan")).check()
    monkeypatch.setitem(sys.modules, "pyfqmr", None)
    Target().check()
    with pytest.raises(MissingLibraryError, match="pyfqmr"):
        Target(faces=100).check()
