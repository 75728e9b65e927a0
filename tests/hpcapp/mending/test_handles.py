"""The shortest loop that bounds nothing, and the cut along it."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.mending.handles import HandleCutter, find_shortest_loop, walk_borders


def torus(around: int, through: int, major: float, minor: float) -> Mesh:
    u, v = np.meshgrid(np.arange(around), np.arange(through), indexing="ij")
    a, b = 2 * np.pi * u / around, 2 * np.pi * v / through
    ring = major + minor * np.cos(b)
    places = np.stack([ring * np.cos(a), ring * np.sin(a), minor * np.sin(b)], axis=-1)

    def at(i: IntArray, j: IntArray) -> IntArray:
        return (i % around) * through + j % through

    quads = np.stack([at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)], axis=-1)
    faces = quads.reshape(-1, 4)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return Mesh(places.reshape(-1, 3), faces)


def length(vertices: FloatArray, loop: IntArray) -> float:
    steps = vertices[loop] - vertices[np.roll(loop, -1)]
    return float(np.linalg.norm(steps, axis=1).sum())


@pytest.mark.parametrize(("major", "minor"), [(3.0, 0.5), (1.3, 1.0)])
def test_the_shortest_loop_leads_around_the_tube_or_through_the_hole(
    major: float, minor: float
) -> None:
    mesh = torus(40, 16, major, minor)
    loop = find_shortest_loop(mesh.vertices, mesh.faces)
    assert loop is not None
    shortest = 2 * np.pi * min(minor, major - minor)
    assert 0.95 * shortest < length(mesh.vertices, loop) < 1.05 * shortest


def test_a_disc_and_a_tube_have_no_loop_that_bounds_nothing() -> None:
    mesh = torus(40, 16, 3.0, 0.5)
    tube = mesh.faces[mesh.vertices[mesh.faces][:, :, 0].max(axis=1) < 2.0]
    assert check_mesh(Mesh(mesh.vertices, tube)).boundaries == 2
    assert find_shortest_loop(mesh.vertices, tube) is None
    assert find_shortest_loop(mesh.vertices, mesh.faces[:2]) is None


@pytest.mark.parametrize(("major", "minor"), [(3.0, 0.5), (1.3, 1.0)])
def test_a_cut_torus_is_a_ball(major: float, minor: float) -> None:
    mesh = torus(40, 16, major, minor)
    cutter = HandleCutter(mesh.vertices, mesh.faces)
    cutter.cut(np.arange(len(mesh.faces)))
    assert (cutter.cuts, cutter.uncut) == (1, {})
    found = check_mesh(Mesh(cutter.vertices, cutter.faces[cutter.is_left]))
    assert found.watertight
    assert found.oriented
    assert found.genus == 0
    assert np.array_equal(cutter.vertices[: len(mesh.vertices)], mesh.vertices)


def test_what_reaches_the_border_of_what_is_here_is_left() -> None:
    mesh = torus(40, 16, 3.0, 0.5)
    # Of each ring around the tube a face is missing, two columns after the one before.
    faces = np.delete(mesh.faces, np.arange(0, len(mesh.faces), 36), axis=0)
    assert find_shortest_loop(mesh.vertices, faces) is not None
    cutter = HandleCutter(mesh.vertices, faces)
    cutter.cut(np.arange(len(faces)))
    assert cutter.cuts == 0
    assert cutter.is_left.all()
    assert np.array_equal(cutter.faces, faces)


def test_borders_are_walked_as_their_faces_run() -> None:
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    [loop], is_simple = walk_borders(faces)
    assert is_simple
    at = loop.tolist().index(0)
    assert [*loop[at:], *loop[:at]] == [0, 1, 2, 3]
    _, is_simple = walk_borders(np.array([[0, 1, 2], [0, 3, 4]]))
    assert not is_simple
