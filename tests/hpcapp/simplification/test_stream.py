"""A mesh that is simplified in runs fits together, whatever blocks it comes in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from level_sets import mesh_level_set

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.simplification.stream import simplify_stream
from hpcapp.simplification.target import Target


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return mesh_level_set(lambda x, y, z: np.hypot(np.hypot(x, y), z) - 1.0, 1.2, 48)


def in_blocks(mesh: Mesh, rows: int) -> MeshStream:
    whole = as_stream(mesh)
    faces = mesh.faces
    return replace(
        whole, faces=lambda: (faces[at : at + rows] for at in range(0, len(faces), rows))
    )


@pytest.mark.parametrize("target", [Target(800), Target(tolerance=0.01), Target(800, 0.01)])
def test_runs_fit_together(ball: Mesh, target: Target) -> None:
    light = simplify_stream(ball, target, run_faces=3000)
    assert check_mesh(light).watertight
    assert check_mesh(light).genus == 0
    assert len(light.faces) < len(ball.faces) / 4
    if target.faces == 800 and target.tolerance is None:
        assert len(light.faces) <= 800
    radii = np.linalg.norm(light.vertices[light.faces].mean(axis=1), axis=1)
    assert np.abs(radii - 1.0).max() < 0.03


def test_blocks_decide_nothing(ball: Mesh) -> None:
    lights = [
        simplify_stream(in_blocks(ball, rows), Target(800), run_faces=3000) for rows in (700, 3001)
    ]
    assert (lights[0].vertices == lights[1].vertices).all()
    assert (lights[0].faces == lights[1].faces).all()
