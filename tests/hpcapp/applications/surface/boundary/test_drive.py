"""Open surfaces against their truth: a cap of a sphere, a hilly ground, a box seen from inside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from disk_clouds import DiskCloudWriter
from passes import measure_read

from hpcapp.applications.surface.boundary.drive import OpeningSettings
from hpcapp.applications.surface.boundary.lengths import Length
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.hierarchical.method import HierarchicalMethod
from hpcapp.applications.surface.job.outcome import Reconstruction
from hpcapp.applications.surface.pipeline import make_surface
from hpcapp.applications.surface.stitching.topology import Topology, check_mesh
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.progress import Progress, StageClock
from hpcapp.workforce import Workforce
from hpccomponent.errors import InputError

GRID = 64


def sphere_points(count: int = 12_000) -> FloatArray:
    """Return points that lie evenly on the unit sphere, in a spiral."""
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def cap(hole: float = 0.0) -> PointCloud:
    """Return the upper half of a sphere, without what lies within `hole` of its pole."""
    points = sphere_points()
    away = np.linalg.norm(points - [0.0, 0.0, 1.0], axis=1)
    points = points[(points[:, 2] > 0.0) & (away >= hole)]
    return PointCloud(points, points)


def ground(count: int = 100) -> PointCloud:
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0.0, 10.0, count)] * 2))
    normals = np.stack([-0.3 * np.cos(x), 0.3 * np.sin(y), np.ones(len(x))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PointCloud(np.stack([x, y, 0.3 * (np.sin(x) + np.cos(y))], axis=1), normals)


def run(
    cloud: PointCloud, opening: OpeningSettings, tile_points: int | None = None
) -> Reconstruction:
    return reconstruct(measure_read(cloud), opening, tile_points)


def reconstruct(
    cloud: ArrangedCloud, opening: OpeningSettings, tile_points: int | None = None
) -> Reconstruction:
    with SerialExecutor() as executor:
        method = HierarchicalMethod(GRID, tile_points=tile_points, opening=opening)
        clock = StageClock(Progress())
        workforce = Workforce(executor, in_process=True)
        return make_surface(cloud, method, workforce, clock)


def open_mesh(
    cloud: PointCloud, opening: OpeningSettings, tile_points: int | None = None
) -> tuple[Mesh, Topology]:
    result = run(cloud, opening, tile_points)
    mesh = result.surface.mesh()
    found = check_mesh(mesh)
    judged = result.surface.check()
    assert (judged.boundaries, judged.boundary_edges) == (found.boundaries, found.boundary_edges)
    assert (judged.components, judged.vertices) == (found.components, found.vertices)
    assert judged.vertices == len(mesh.vertices)
    assert found.edge_manifold
    assert found.vertex_manifold
    assert found.oriented
    return mesh, found


def find_rim(mesh: Mesh) -> FloatArray:
    """Return the vertices on the boundary."""
    sides = np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    rim: FloatArray = mesh.vertices[np.unique(edges[counts == 1])]
    return rim


def test_an_object_stays_closed_to_the_last_byte() -> None:
    sphere = PointCloud(sphere_points(), sphere_points())
    closed, auto = (run(sphere, OpeningSettings(close)) for close in ("yes", "auto"))
    assert auto.facts["open"] is False
    one, other = closed.surface.mesh(), auto.surface.mesh()
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.faces.tobytes() == other.faces.tobytes()


def test_a_view_is_open_with_one_clean_boundary() -> None:
    mesh, found = open_mesh(cap(), OpeningSettings("no"))
    assert (found.boundaries, found.components) == (1, 1)
    spacing = np.sqrt(4.0 * np.pi / 12_000)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1.0).max() < spacing
    rim = find_rim(mesh)
    assert -2.0 * spacing < rim[:, 2].min()  # no skirt
    assert np.ptp(rim[:, 2]) < spacing  # no teeth


@pytest.mark.parametrize("count", [22, 45, 100])
def test_ground_ends_where_its_points_do(count: int) -> None:
    mesh, found = open_mesh(ground(count), OpeningSettings("auto"))
    assert (found.boundaries, found.components) == (1, 1)
    spacing = 10.0 / (count - 1)
    beyond = np.concatenate(
        [-mesh.vertices[:, :2].min(axis=0), mesh.vertices[:, :2].max(axis=0) - 10.0]
    )
    assert beyond.min() > 0.0
    assert beyond.max() < 2.0 * spacing


def test_ground_has_no_skirt() -> None:
    mesh, found = open_mesh(ground(), OpeningSettings("auto"))
    x, y, z = mesh.vertices.T
    assert found.boundaries == 1
    assert np.abs(z - 0.3 * (np.sin(x) + np.cos(y))).max() < 0.1
    assert mesh.vertices[:, :2].min() > -0.45
    assert mesh.vertices[:, :2].max() < 10.45


def test_a_room_has_no_outside() -> None:
    sphere = PointCloud(sphere_points(), -sphere_points())  # the box around it is the outside
    result = run(sphere, OpeningSettings("auto"))
    assert result.facts["open"]
    radii = np.linalg.norm(result.surface.mesh().vertices, axis=1)
    assert np.abs(radii - 1.0).max() < 0.05


@pytest.mark.parametrize("tile_points", [None, 3_000])
def test_what_is_around_a_room_does_not_fill_its_door(tile_points: int | None) -> None:
    turn, z = (
        a.ravel() for a in np.meshgrid(np.arange(0.0, 6.28, 0.15), np.arange(1.0, 1.3, 0.03))
    )
    inwards = -np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    walls = sphere_points()[np.linalg.norm(sphere_points() - [0.0, 0.0, 1.0], axis=1) > 0.2]
    points = np.concatenate([walls, -0.2 * inwards + z[:, None] * [0.0, 0.0, 1.0]])
    room = PointCloud(points, np.concatenate([-walls, inwards]))
    asked = OpeningSettings("no", None, Length(1.0, False))  # the door is .5 across
    mesh, _ = open_mesh(room, asked, tile_points)
    assert np.abs(mesh.vertices).max(axis=0) == pytest.approx([1.0, 1.0, 1.3], abs=0.06)


@pytest.mark.parametrize(("fill", "boundaries"), [(0.2, 2), (1.4, 1)])
def test_holes_are_filled_up_to_a_length(fill: float, boundaries: int) -> None:
    asked = OpeningSettings("no", Length(3.0, True), Length(fill, False))
    mesh, found = open_mesh(cap(hole=0.5), asked)
    assert found.boundaries == boundaries
    assert (mesh.vertices[:, 2].max() > 0.98) == (boundaries == 1)


def test_the_border_is_half_as_far_from_the_points_as_asked() -> None:
    cloud = cap()
    mesh, _ = open_mesh(cloud, OpeningSettings("auto", Length(0.2, False), Length(0.0, False)))
    rim = find_rim(mesh)
    away = np.linalg.norm(rim[:, None] - cloud.positions[cloud.positions[:, 2] < 0.2], axis=2)
    assert 0.05 < away.min(axis=1).max() <= 0.1


@pytest.mark.parametrize("count", [1, 8, 12, 20, 40])
@pytest.mark.parametrize("side", [0.5, 2.0])
def test_crumbs_go_and_objects_stay(count: int, side: float) -> None:
    """An object of five spacings is one; a clump of strays, all on one spot, is a crumb."""
    cloud = ground()
    random = np.random.default_rng(0)
    crumb = np.array([5.0, 5.0, 4.0]) + random.uniform(-0.02, 0.02, (count, 3)) * [1.0, 1.0, 0.01]
    lines = np.linspace(2.0, 2.0 + side, round(side / 0.1) + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(lines, lines))
    shelf = np.stack([x, y, np.full(len(x), 3.0)], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (len(crumb) + len(shelf), 1))
    positions = np.concatenate([cloud.positions, crumb, shelf])
    assert cloud.normals is not None
    both = PointCloud(positions, np.concatenate([cloud.normals, up]))
    # Without holes filled: the bare side of what grew around the crumb may be as small as one.
    result = run(both, OpeningSettings("no", None, Length(0.0, False)))
    mesh = result.surface.mesh()
    assert check_mesh(mesh).components == 2
    assert mesh.vertices[:, 2].max() < 3.5


def test_tiles_give_the_same_bytes() -> None:
    cloud = cap(hole=0.2)
    for asked in (OpeningSettings("auto"), OpeningSettings("no", None, Length(0.0, False))):
        whole, _ = open_mesh(cloud, asked)
        tiled, _ = open_mesh(cloud, asked, tile_points=500)
        assert tiled.vertices.tobytes() == whole.vertices.tobytes()
        assert tiled.faces.tobytes() == whole.faces.tobytes()


@pytest.mark.parametrize("asked", [OpeningSettings("auto"), OpeningSettings("no")])
def test_points_on_a_disk_give_the_same_bytes(asked: OpeningSettings, tmp_path: Path) -> None:
    """Of an uneven cloud, where the largest reach is that of its sparsest points."""
    whole = cap(hole=0.2)
    assert whole.normals is not None
    dense = whole.positions[:, 0] > 0.5
    kept = dense | (np.arange(len(whole)) % 16 == 0)
    cloud = measure_read(PointCloud(whole.positions[kept], whole.normals[kept]))
    writer = DiskCloudWriter(tmp_path, cloud.arrangement, cloud.origin)
    writer.add(*cloud.take_blocks(cloud.keys))
    disk = replace(writer.finish(), noted=cloud.measured)
    one, other = (reconstruct(some, asked, 500).surface.mesh() for some in (cloud, disk))
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.faces.tobytes() == other.faces.tobytes()


def test_where_nothing_is_left_it_is_said_what_to_do() -> None:
    with pytest.raises(InputError, match="crumb"):
        run(cap(), OpeningSettings("no", Length(1e-4, False)))
