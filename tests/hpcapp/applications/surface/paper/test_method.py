from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures._base import Future
from typing import Any, ParamSpec, TypeVar

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.paper.method import PaperMethod, PaperPartition, measure_residuals
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.workforce import Workforce
from hpccomponent.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")

RADIUS = 2.0


def ignore(done: int, total: int) -> None:
    pass


def sphere(n: int = 4000) -> PointCloud:
    normals = random_directions(n, 13)
    return PointCloud(RADIUS * normals, normals, origin=np.array([1e6, 2e6, 0.0]))


@pytest.fixture
def workforce() -> Iterator[Workforce]:
    with ThreadPoolExecutor(2) as executor:
        yield Workforce(executor, 2)


def run(
    method: PaperMethod, cloud: PointCloud, workforce: Workforce
) -> tuple[PaperPartition, FloatArray, Mesh]:
    partition = method.partition(MemoryCloud.as_they_are(cloud), workforce)
    quadrics = method.fit(partition, workforce, ignore)
    surface = method.extract(partition, quadrics, workforce, ignore)
    return partition, quadrics, surface.mesh()


def test_one_patch_on_a_sphere_gives_the_sphere(workforce: Workforce) -> None:
    _, _, mesh = run(PaperMethod(patches=1, grid=32), sphere(), workforce)
    radii = np.linalg.norm(mesh.vertices, axis=1)
    cell, errors = 2.0 * RADIUS / 32, np.abs(radii - RADIUS)
    # Linear interpolation of a quadratic function over one cell; where the sphere touches its
    # box, and the blend ends, up to one cell.
    assert np.mean(errors < cell**2 / RADIUS) > 0.95
    assert errors.max() < cell
    topology = check_mesh(mesh)
    assert topology.watertight
    assert topology.outward
    assert topology.components == 1
    assert mesh.origin.tolist() == [1e6, 2e6, 0.0]


@pytest.mark.parametrize("norm", ["consistent", "printed"])
def test_every_patch_of_a_sphere_is_fitted_exactly(workforce: Workforce, norm: str) -> None:
    # Patches of a sphere have one quadric through them, the sphere, if they are not too small.
    method = PaperMethod(max_points=1000, cone="none", norm=norm)
    partition, quadrics, _ = run(method, sphere(), workforce)
    residuals = measure_residuals(partition, quadrics)
    assert len(partition.patches) > 4
    assert residuals["residual_rms"] < 1e-9
    assert residuals["residual_median_percent"] < 1e-7
    assert residuals["normals_agreeing"] == 1.0


def test_the_surface_of_several_patches_holds_all_points(workforce: Workforce) -> None:
    cloud = sphere()
    _, _, mesh = run(PaperMethod(max_points=1000, cone="none", grid=32), cloud, workforce)
    # The blend adds walls at box faces; it takes nothing away.
    radii = np.linalg.norm(mesh.vertices, axis=1)
    near = mesh.vertices[np.abs(radii - RADIUS) < 0.05]
    distances = np.linalg.norm(cloud.positions[:200, None] - near[None], axis=2).min(axis=1)
    assert distances.max() < 2.0 * RADIUS / 32


@pytest.mark.parametrize("options", [{"delta": 0.2}, {"patches": 37}, {"max_points": 100}])
def test_any_number_of_workers_gives_the_same_bytes(
    options: dict[str, Any], workforce: Workforce
) -> None:
    cloud = sphere()
    method = PaperMethod(grid=24, **options)
    meshes = [
        run(method, cloud, Workforce(workforce.executor, workers, per_worker))[2]
        for workers, per_worker in ((1, 1), (3, 1), (4, 5))
    ]
    assert len({mesh.vertices.tobytes() for mesh in meshes}) == 1
    assert len({mesh.faces.tobytes() for mesh in meshes}) == 1


class RecordingExecutor(ThreadPoolExecutor):
    """An executor that remembers how many patches each batch held."""

    def __init__(self) -> None:
        super().__init__(1)
        self.patches: list[int] = []

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        centers = args[3]
        assert isinstance(centers, np.ndarray)
        self.patches.append(len(centers))
        return super().submit(fn, *args, **kwargs)


def test_each_worker_gets_as_many_patches() -> None:
    told = []
    method = PaperMethod(patches=40)
    with RecordingExecutor() as executor:
        workforce = Workforce(executor, 4)
        partition = method.partition(MemoryCloud.as_they_are(sphere()), workforce)
        method.fit(partition, workforce, lambda *counts: told.append(counts))
    assert executor.patches == [10, 10, 10, 10]
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_points_lie_patch_after_patch_with_their_normals(workforce: Workforce) -> None:
    cloud = sphere()
    partition = PaperMethod().partition(MemoryCloud.as_they_are(cloud), workforce)
    order = partition.patches.order
    assert np.array_equal(partition.points.positions, cloud.positions[order])
    assert cloud.normals is not None
    assert partition.points.normals is not None
    assert np.array_equal(partition.points.normals, cloud.normals[order])


def test_facts_say_what_was_chosen_and_found(workforce: Workforce) -> None:
    method = PaperMethod(delta=0.3, cone="complement", max_points=500)
    partition, _, _ = run(method, sphere(), workforce)
    facts = json.loads(json.dumps(method.facts(partition)))
    assert facts["patches"] == len(partition.patches)
    assert facts["delta"] == 0.3
    assert facts["cone"] == "complement"
    assert facts["largest_patch"] <= facts["max_points"] == 500
    assert facts["residual_rms"] >= 0.0


def test_facts_of_a_given_number_of_patches_name_no_cone(workforce: Workforce) -> None:
    method = PaperMethod(patches=12)
    facts = method.facts(method.partition(MemoryCloud.as_they_are(sphere()), workforce))
    assert facts["patches"] == 12
    assert "cone" not in facts


def test_a_cloud_without_normals_is_refused(workforce: Workforce) -> None:
    with pytest.raises(InputError, match="no normals"):
        PaperMethod().partition(MemoryCloud.as_they_are(PointCloud(sphere().positions)), workforce)
