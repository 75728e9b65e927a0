"""Edges between planes and cylinders of any direction, cut by marching cubes, and mended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from cut_mesh import GRID, extract_shape
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hpcapp.applications.surface.extraction import sharpening
from hpcapp.applications.surface.extraction.sharpening import sharpen_vertices
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.lattice import pack_places, unpack_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.kernels.types.field import Features

LATTICE = (np.array([-1.1, -1.1, -1.1]), 1.5 * GRID.step)
BALL = 0.8
NO_FEATURES = Features(
    np.empty(0, np.int64), np.empty((0, 3, 10), np.float32), np.empty(0, np.uint8)
)


@dataclass(frozen=True)
class Wedge:
    """Two half-spaces, joined by max (convex) or min (concave)."""

    normals: FloatArray  # (2, 3)
    offset: FloatArray
    is_convex: bool

    def pieces(self, points: FloatArray) -> FloatArray:
        found: FloatArray = (points - self.offset) @ self.normals.T
        return found

    def __call__(self, points: FloatArray) -> FloatArray:
        pieces = self.pieces(points)
        joined = pieces.max(axis=-1) if self.is_convex else pieces.min(axis=-1)
        inside: FloatArray = np.maximum(joined, np.linalg.norm(points, axis=-1) - BALL)
        return inside

    def features(self) -> Features:
        """Return what the fits would find along the edge, away from the ball."""
        origin, cell = LATTICE
        near = np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        places = origin + cell * near
        values = self.pieces(places)
        kept = np.abs(values).max(axis=1) < 2.5 * cell
        kept &= np.linalg.norm(places, axis=1) < BALL - 3.0 * cell
        keys = pack_places(near[kept])
        order = np.argsort(keys)
        pieces = np.zeros((len(keys), 3, 10), np.float32)
        for piece, of in enumerate((0, 1, 1)):
            pieces[:, piece, 0] = values[kept][order, of] / cell
            pieces[:, piece, 1:4] = self.normals[of]
        joint = 0 if self.is_convex else 3
        return Features(keys[order], pieces, np.full(len(keys), joint, np.uint8))


def make_wedge(seed: int, angle: float, is_convex: bool) -> Wedge:
    """Return a wedge of some dihedral angle, in radians, through about the middle."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    first = np.array([1.0, 0.0, 0.0])
    second = np.array([np.cos(np.pi - angle), np.sin(np.pi - angle), 0.0])
    return Wedge(np.stack([first, second]) @ turn, rng.uniform(-0.1, 0.1, 3), is_convex)


def sharpen(wedge: Wedge, features: Features) -> tuple[Mesh, FloatArray]:
    mesh, *_ = extract_shape(wedge)
    steps = np.full(len(mesh.vertices), GRID.step)
    found = sharpen_vertices(mesh.vertices, mesh.faces, mesh.vertices, features, LATTICE, steps)
    return mesh, found


def beside_the_edge(wedge: Wedge, points: FloatArray) -> BoolArray:
    near = np.abs(wedge.pieces(points)).max(axis=-1) < 1.2 * GRID.step
    inner: BoolArray = near & (np.linalg.norm(points, axis=-1) < BALL - 7.0 * GRID.step)
    return inner


def face_normals(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    lengths = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(lengths, 1e-300)[:, None], lengths


def count_cut(wedge: Wedge, vertices: FloatArray, faces: IntArray) -> int:
    """Return how many faces look 8 degrees and more away from both pieces."""
    normals, _ = face_normals(vertices, faces)
    return int(((normals @ wedge.normals.T).max(axis=1) < 0.99).sum())


WEDGES = {
    "seed": st.integers(0, 2**32 - 1),
    "angle": st.floats(0.8, 2.4),
    "is_convex": st.booleans(),
}


@pytest.mark.parametrize("is_convex", [True, False])
@pytest.mark.parametrize(("angle", "left"), [(1.2, 0.5), (1.57, 0.2), (2.0, 0.1)])
def test_faces_along_an_edge_lie_on_one_side_of_it(
    angle: float, left: float, is_convex: bool
) -> None:
    before = after = 0
    for seed in range(12):
        wedge = make_wedge(seed, angle, is_convex)
        mesh, vertices = sharpen(wedge, wedge.features())
        of_edge = mesh.faces[beside_the_edge(wedge, mesh.vertices)[mesh.faces].all(axis=1)]
        before += count_cut(wedge, mesh.vertices, of_edge)
        after += count_cut(wedge, vertices, of_edge)
    assert before > 300
    assert after <= left * before


@settings(max_examples=40, deadline=None)
@given(**WEDGES)
def test_moved_vertices_lie_on_the_edge_and_all_others_stay(
    seed: int, angle: float, is_convex: bool
) -> None:
    wedge = make_wedge(seed, angle, is_convex)
    mesh, vertices = sharpen(wedge, wedge.features())
    moved = (vertices != mesh.vertices).any(axis=1)
    assume(moved.any())
    assert np.abs(wedge.pieces(vertices[moved])).max() < 1e-5
    assert np.linalg.norm(vertices - mesh.vertices, axis=1).max() <= 1.5 * GRID.step + 1e-12


@settings(max_examples=40, deadline=None)
@given(**WEDGES)
def test_hardly_a_face_turns_over_and_none_vanishes(
    seed: int, angle: float, is_convex: bool
) -> None:
    wedge = make_wedge(seed, angle, is_convex)
    mesh, vertices = sharpen(wedge, wedge.features())
    after, areas = face_normals(vertices, mesh.faces)
    touched = (vertices != mesh.vertices).any(axis=1)[mesh.faces].any(axis=1)
    assert ((after @ wedge.normals.T).max(axis=1)[touched] <= 0.0).sum() <= 0.01 * touched.sum()
    assert (areas[touched] > 1e-6 * GRID.step**2).all()
    found = check_mesh(Mesh(vertices, mesh.faces))
    assert found.watertight
    assert found.oriented


@settings(max_examples=25, deadline=None)
@given(axis=st.integers(0, 2), cut=st.integers(12, 30), **WEDGES)
def test_a_vertex_depends_on_seven_faces_around_it(
    axis: int, cut: int, seed: int, angle: float, is_convex: bool
) -> None:
    # As a tile has it: its own faces, and those of the cells around.
    wedge = make_wedge(seed, angle, is_convex)
    features = wedge.features()
    mesh, whole = sharpen(wedge, features)
    cells = np.floor((mesh.vertices[mesh.faces].mean(axis=1) - GRID.origin) / GRID.step)[:, axis]
    part = mesh.faces[cells < cut + 7]
    steps = np.full(len(mesh.vertices), GRID.step)
    alone = sharpen_vertices(mesh.vertices, part, mesh.vertices, features, LATTICE, steps)
    own = np.unique(mesh.faces[cells < cut])
    np.testing.assert_array_equal(alone[own], whole[own])


@settings(max_examples=25, deadline=None)
@given(every=st.integers(2, 40), **WEDGES)
def test_faces_that_are_passed_over_lie_by_no_feature(
    every: int, seed: int, angle: float, is_convex: bool
) -> None:
    wedge = make_wedge(seed, angle, is_convex)
    all_of = wedge.features()
    few = Features(all_of.keys[::every], all_of.pieces[::every], all_of.joints[::every])
    _, found = sharpen(wedge, few)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sharpening, "_mark_near", lambda places, *_: np.ones(len(places), np.bool_))
        _, wanted = sharpen(wedge, few)
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("part", ["no face", "faces far from all edges"])
def test_where_no_face_is_near_an_edge_vertices_are_balanced(part: str) -> None:
    wedge = make_wedge(1, 1.4, True)
    mesh, *_ = extract_shape(wedge)
    features = wedge.features()
    steps = np.full(len(mesh.vertices), GRID.step)
    places = (mesh.vertices - LATTICE[0]) / LATTICE[1]
    is_far = ~sharpening._mark_near(places, steps / LATTICE[1], features)
    faces = mesh.faces[is_far[mesh.faces].all(axis=1)]
    assert len(faces)
    if part == "no face":
        faces = faces[:0]
    balanced = mesh.vertices + 0.01
    found = sharpen_vertices(mesh.vertices, faces, balanced, features, LATTICE, steps)
    np.testing.assert_array_equal(found, balanced)


def test_beside_an_edge_vertices_are_not_balanced() -> None:
    wedge = make_wedge(1, 1.4, True)
    mesh, *_ = extract_shape(wedge)
    balanced = mesh.vertices + 0.01 * GRID.step
    of = (
        mesh.vertices,
        mesh.faces,
        balanced,
        wedge.features(),
        LATTICE,
        np.full(len(mesh.vertices), GRID.step),
    )
    found = sharpen_vertices(*of)
    on_edge = np.abs(wedge.pieces(found)).max(axis=1) < 1e-5
    on_edge &= (found != mesh.vertices).any(axis=1)
    around = np.unique(mesh.faces[on_edge[mesh.faces].any(axis=1)])
    beside = np.setdiff1d(around, np.flatnonzero(on_edge))
    np.testing.assert_array_equal(found[beside], mesh.vertices[beside])
    others = np.setdiff1d(np.arange(len(found)), around)
    share = (found[others] == balanced[others]).all(axis=1).mean()
    assert share > 0.99, "all but those beside vertices that were put back"


def test_without_features_nothing_is_moved() -> None:
    wedge = make_wedge(2, 1.5, True)
    mesh, found = sharpen(wedge, NO_FEATURES)
    assert found is mesh.vertices


@pytest.mark.parametrize("shift", [0.4, 1.0])
def test_pieces_that_are_not_the_surface_move_nothing(shift: float) -> None:
    wedge = make_wedge(3, 1.5, True)
    features = wedge.features()
    features.pieces[:, :, 0] += np.float32(shift)
    mesh, found = sharpen(wedge, features)
    np.testing.assert_array_equal(found, mesh.vertices)


def test_the_features_are_where_the_edge_is() -> None:
    wedge = make_wedge(4, 1.5, True)
    origin, cell = LATTICE
    places = origin + cell * unpack_keys(wedge.features().keys)
    assert len(places) > 50
    assert np.abs(wedge.pieces(places)).max() < 2.5 * cell
