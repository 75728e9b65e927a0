"""The metrics on meshes whose distance from the truth is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from level_sets import mesh_level_set

from hpcapp.applications.compare import nearest
from hpcapp.applications.compare.metrics import measure_mesh
from hpcapp.applications.compare.nearest import NearestFace
from hpcapp.applications.compare.truth import (
    MeshTruth,
    PointTruth,
    ShapeTruth,
    Truth,
)
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.lab.simulate.implicit import diagonal_of
from hpcapp.lab.simulate.shapes import SHAPES


def ball(radius: float = 1.0, cells: int = 40) -> Mesh:
    mesh = mesh_level_set(lambda *at: np.linalg.norm(at, axis=0) - radius, 1.3 * radius, cells)
    lengths = np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return Mesh(radius * mesh.vertices / lengths, mesh.faces)


@pytest.fixture(scope="module")
def sphere() -> ShapeTruth:
    return ShapeTruth(SHAPES["sphere"])


def test_a_fine_mesh_of_the_truth_is_close_in_every_measure(sphere: ShapeTruth) -> None:
    found = measure_mesh(ball(), sphere, samples=4000)
    assert found.l1 < 0.1
    assert found.normal_deg < 3.0
    assert found.f_scores["0.5"] == 1.0
    assert found.topology.watertight


def test_a_swollen_mesh_is_as_far_away_as_it_swelled(sphere: ShapeTruth) -> None:
    found = measure_mesh(ball(radius=1.02, cells=60), sphere, samples=4000)
    expected = 100 * 0.02 / diagonal_of(SHAPES["sphere"])
    assert found.accuracy == pytest.approx(expected, rel=0.05)
    assert found.completeness == pytest.approx(expected, rel=0.05)
    assert found.f_scores["0.5"] == 0.0


def test_a_missing_half_costs_completeness_and_not_accuracy(sphere: ShapeTruth) -> None:
    whole = ball()
    half = Mesh(whole.vertices, whole.faces[whole.vertices[whole.faces, 2].mean(axis=1) > 0])
    found = measure_mesh(half, sphere, samples=4000)
    assert found.accuracy < 0.1
    assert found.completeness > 5.0
    assert found.hausdorff == pytest.approx(100 * np.sqrt(2) / np.sqrt(12), rel=0.05)
    assert not found.topology.watertight


def test_an_open_truth_is_judged_by_completeness() -> None:
    whole = ball()
    found = measure_mesh(whole, MeshTruth(Mesh(whole.vertices, whole.faces[50:])), samples=2000)
    assert np.isnan(found.accuracy)
    assert found.l1 == found.completeness < 1e-10


def test_samples_lie_on_the_faces_evenly() -> None:
    cloud = sample_faces(ball(), 8000)
    assert NearestFace(ball()).query(cloud.positions)[0].max() < 1e-12
    share = np.histogram(cloud.positions[:, 2], bins=5, range=(-1, 1))[0] / 8000
    assert share == pytest.approx(0.2, abs=0.02)


def test_the_nearest_face_is_that_of_a_search_through_all() -> None:
    rng = np.random.default_rng(1)
    # One triangle a hundred times the others' size must not hide behind its distant middle.
    corners = rng.random((60, 3, 3)) * 0.2 + rng.random((60, 1, 3))
    corners[0] = [[-9, -9, 0.5], [9, -9, 0.5], [0, 14, 0.5]]
    mesh = Mesh(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3))
    points = rng.random((200, 3)) * 2 - 0.5
    every = [NearestFace(Mesh(mesh.vertices, mesh.faces[[k]])).query(points)[0] for k in range(60)]
    distances, faces = NearestFace(mesh).query(points)
    assert distances == pytest.approx(np.min(every, axis=0), abs=1e-12)
    assert np.array(every)[faces, np.arange(200)] == pytest.approx(distances, abs=1e-12)


def test_the_distance_to_a_triangle_knows_face_side_and_corner() -> None:
    triangle = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    points = np.array([[0.2, 0.2, 3.0], [0.5, -2.0, 0.0], [-3.0, -4.0, 0.0], [1.0, 1.0, 0.0]])
    assert NearestFace(triangle).query(points)[0] == pytest.approx([3, 2, 5, np.sqrt(0.5)])


def test_far_points_are_exact_too() -> None:
    whole = ball()
    points = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [30.0, 0.0, 0.0], [20.0, 20.0, 20.0]])
    a, b, c = np.moveaxis(whole.vertices[whole.faces], 1, 0)
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    feet = across * np.einsum("ij,ij->i", across, a)[:, None]  # of zero, on the planes of the faces
    sides = [
        np.einsum("ij,ij->i", np.cross(q - p, feet - p), across)
        for p, q in ((a, b), (b, c), (c, a))
    ]
    is_within = np.min(sides, axis=0) >= 0.0
    ends = []
    for p, q in ((a, b), (b, c), (c, a)):
        along = -np.einsum("ij,ij->i", p, q - p) / np.einsum("ij,ij->i", q - p, q - p)
        ends.append(np.linalg.norm(p + np.clip(along, 0.0, 1.0)[:, None] * (q - p), axis=1))
    expected = min(np.linalg.norm(feet[is_within], axis=1).min(), np.min(ends))
    distances = NearestFace(whole).query(points)[0]
    assert distances[0] == pytest.approx(expected, abs=1e-12)
    assert distances[2] == pytest.approx(29.0, abs=2e-3)
    assert distances[3] == pytest.approx(np.sqrt(1200) - 1.0, abs=2e-3)


def count_pairs(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that grows by the pairs of a point and a triangle that are measured."""
    counts: list[int] = []
    measure = nearest.distance_to_triangles

    def counted(points: FloatArray, triangles: FloatArray) -> FloatArray:
        counts.append(len(points))
        return measure(points, triangles)

    monkeypatch.setattr(nearest, "distance_to_triangles", counted)
    return counts


@pytest.mark.parametrize("away", [1e3, 1e6, 1e9, 1e30, 1e100])
@pytest.mark.parametrize("truth_of", [MeshTruth, lambda mesh: PointTruth(sample_faces(mesh, 9000))])
def test_a_stray_vertex_costs_no_more(
    away: float, truth_of: Callable[[Mesh], Truth], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = ball(cells=30)
    vertices = whole.vertices.copy()
    vertices[7] = [away, 0.0, 0.0]
    truth = truth_of(whole)
    counts = count_pairs(monkeypatch)
    found = measure_mesh(Mesh(vertices, whole.faces), truth, samples=1000)
    assert sum(counts) < 40 * 2000
    assert max(counts) < 40 * 1000
    assert found.completeness < 1e-3
    # by area, samples of a triangle are at two thirds of its height on average
    assert found.accuracy == pytest.approx(100 * away / 3 / truth.diagonal, rel=0.05)


def test_points_are_a_truth_without_normals() -> None:
    whole = ball()
    truth = PointTruth(PointCloud(sample_faces(whole, 20_000, seed=3).positions))
    found = measure_mesh(whole, truth, samples=3000)
    assert found.completeness < 1e-10
    assert 0.0 < found.accuracy < 1.0  # the points' spacing
    assert np.isnan(found.normal_deg)
    assert found.p95 <= found.hausdorff


def test_a_seed_gives_the_same_measures_again() -> None:
    truth = MeshTruth(ball(cells=20))
    first, again, other = (measure_mesh(ball(), truth, 500, seed) for seed in (5, 5, 6))
    assert first == again != other
