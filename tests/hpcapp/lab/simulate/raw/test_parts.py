"""What scenes are made of: rays meet the very surface that the mesh shows."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.compare.nearest import face_normals
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.implicit import diagonal_of
from hpcapp.lab.simulate.raw.parts import (
    HeightField,
    ScenePart,
    make_boxes,
    make_houses,
    make_model,
    make_trunks,
)
from hpcapp.lab.simulate.shapes import SHAPES


def hills() -> HeightField:
    return HeightField(np.random.default_rng(0).uniform(0.0, 1.0, (9, 7)), 0.5)


def houses() -> ScenePart:
    feet = np.array([[0.0, 0.0, 1.0], [8.0, 1.0, 2.0], [7.0, 7.0, 1.0], [-1.0, 6.0, 0.5]])
    return make_houses([feet, feet + np.array([20.0, 0.0, 0.0])], [4.0, 5.0], [6.0, 8.0])


def room() -> ScenePart:
    return make_boxes(
        [
            ((-1.0, -1.0, -1.0), (5.0, 4.0, 3.0), True),
            ((0.0, 0.0, 0.0), (4.0, 3.0, 2.0), False),
            ((1.0, 1.0, -0.1), (2.0, 2.0, 0.7), True),
            ((3.9, 1.0, 0.5), (4.2, 2.0, 1.5), False),
        ]
    )


def trunks() -> ScenePart:
    return make_trunks(np.array([[0.0, 0.0, 0.0], [1.5, 0.0, 0.2]]), np.array([3.0, 5.0]), 0.2)


PARTS = {
    "hills": (hills().as_part(), 1e-12),
    "houses": (houses(), 1e-12),
    "room": (room(), 1e-12),
    "trunks": (trunks(), 0.2 * (1.0 - np.cos(np.pi / 24.0)) + 1e-12),
    "model": (make_model(SHAPES["torus"]), 1e-4 * diagonal_of(SHAPES["torus"])),
}


def sample(part: ScenePart) -> tuple[FloatArray, FloatArray]:
    """A place on every face, off its edges, and the normal there."""
    triangles = part.mesh.vertices[part.mesh.faces]
    return np.einsum("ijk,j->ik", triangles, [0.5, 0.3, 0.2]), face_normals(part.mesh)


@pytest.mark.parametrize("name", PARTS)
def test_field_and_mesh_are_one_surface_that_faces_the_air(name: str) -> None:
    part, tolerance = PARTS[name]
    places, normals = sample(part)
    assert np.abs(part.field.value(places)).max() < tolerance
    slopes = part.field.gradient(places)
    slopes /= np.linalg.norm(slopes, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", slopes, normals).min() > 0.9


@pytest.mark.parametrize("name", PARTS)
def test_a_field_changes_no_faster_than_the_distance(name: str) -> None:
    part, _ = PARTS[name]
    rng = np.random.default_rng(1)
    low, high = part.mesh.vertices.min(axis=0), part.mesh.vertices.max(axis=0)
    first = rng.uniform(low, high, (4000, 3))
    step = 0.05 * rng.standard_normal((4000, 3))
    change = np.abs(part.field.value(first + step) - part.field.value(first))
    assert (change <= np.linalg.norm(step, axis=1) * (1.0 + 1e-9)).all()


def test_a_room_of_boxes_is_closed_around_the_air_in_it() -> None:
    topology = check_mesh(room().mesh)
    assert topology.watertight
    # air of 4 x 3 x 2, less a block of 1 x 1 x 0.7, with a niche of 0.2 x 1 x 1
    a, b, c = (room().mesh.vertices[room().mesh.faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    assert volume == pytest.approx(-(24.0 - 0.7 + 0.2))
