"""A job that is asked for a part makes the part of the mesh that a job of the whole makes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from clipped_meshes import sample
from directions import random_directions
from scipy.spatial import cKDTree

import hpcapp as package
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.geometry.points import PointCloud
from hpcapp.geometry.regions.prism import Prism
from hpcapp.io import read_mesh, write_points
from hpcapp.parts.crop import Crop, make_crop
from hpcapp.progress import Progress
from hpccomponent.errors import InputError

BOX = (5.0, -3.0, -10.0, 15.0, 7.0, 10.0)
BALL = (10.0, 0.0, 0.0, 6.0)
ON_A_MAP = np.array([512_000.0, 5_403_000.0, 300.0])


@pytest.fixture(scope="module")
def knot() -> PointCloud:
    return package.simulate("knot", points=20_000, noise=0.003)


def test_a_mesh_ends_on_the_box_in_the_coordinates_of_a_map(knot: PointCloud) -> None:
    moved = PointCloud(knot.positions + ON_A_MAP, knot.normals)
    box = tuple(np.add(BOX, np.tile(ON_A_MAP, 2)).tolist())
    mesh = package.reconstruct(moved, box=box, executor="serial")
    low, high = np.array(box[:3]), np.array(box[3:])
    assert (mesh.bounds >= low).all()
    assert (mesh.bounds <= high).all()
    assert mesh.bounds[0][0] == low[0]
    assert mesh.bounds[1][1] == high[1]
    assert not mesh.is_watertight


def test_a_ball_on_feet_and_metres_is_one_of_feet(tmp_path: Path) -> None:
    directions = random_directions(12_000, 4)
    scales = np.array([1.0, 1.0, 0.3048])
    path, output = tmp_path / "ball.ply", tmp_path / "mesh.ply"
    centre = np.array([2e6, 5e5, 100.0])
    cloud = PointCloud(30.0 * directions * scales + centre, directions / scales)
    write_points(path, cloud, "EPSG:2229", "ft", height_unit="m")
    place = np.array([2e6, 5e5, 100.0 + 30.0 * 0.3048])  # the top
    crop = Crop(around=(*place.tolist(), 20.0))
    run_job(JobSettings(points=path, output=str(output), crop=crop, backend="serial"), Progress())
    mesh = read_mesh(output)
    arms = (mesh.vertices + mesh.origin - place) / scales
    assert np.linalg.norm(arms, axis=1).max() == pytest.approx(20.0, abs=1e-3)


@pytest.mark.parametrize("suffix", [".ply", ".xyz"])
def test_in_memory_and_in_a_folder_the_bytes_are_the_same(
    knot: PointCloud, tmp_path: Path, suffix: str
) -> None:
    points = tmp_path / f"knot{suffix}"
    attributes = {"height": knot.positions[:, 2].copy()} if suffix == ".ply" else {}
    write_points(points, PointCloud(knot.positions, knot.normals, attributes=attributes))
    made = []
    for number, memory in enumerate((None, 3e8)):
        output = tmp_path / f"{number}.ply"
        job = JobSettings(
            points=points, output=str(output), crop=Crop(box=BOX), backend="serial",
            max_memory=memory, temp_dir=None if memory is None else str(tmp_path / "points"),
        )  # fmt: skip
        run_job(job, Progress())
        made.append(output.read_bytes())
    assert made[0] == made[1]


def test_workers_that_read_the_file_leave_out_the_same_points(
    knot: PointCloud, tmp_path: Path
) -> None:
    points = tmp_path / "knot.ply"
    spoiled = knot.positions.copy()
    spoiled[::1000] = np.nan
    write_points(points, PointCloud(spoiled, knot.normals))
    made = []
    for backend in ("serial", "zmq"):
        output, is_here = tmp_path / f"{backend}.ply", backend == "serial"
        job = JobSettings(
            points=points, output=str(output), crop=Crop(around=BALL), backend=backend,
            workers=1 if is_here else 2, max_memory=None if is_here else 3e8,
        )  # fmt: skip
        run_job(job, Progress())
        made.append(output.read_bytes())
    assert made[0] == made[1]


def test_of_several_files_the_mesh_is_that_of_one(knot: PointCloud, tmp_path: Path) -> None:
    names = [tmp_path / "one.ply", tmp_path / "two.ply"]
    for path, part in zip(names, (slice(0, 10_000), slice(10_000, None)), strict=True):
        write_points(path, knot.view(part))
    mesh = package.reconstruct(names, box=BOX, executor="serial", attributes="none")
    write_points(tmp_path / "both.ply", knot)
    one = package.reconstruct(tmp_path / "both.ply", box=BOX, executor="serial", attributes="none")
    assert np.array_equal(mesh.vertices, one.vertices)
    assert np.array_equal(mesh.faces, one.faces)


@pytest.mark.parametrize("suffix", [".ply", ".xyz"])
@pytest.mark.parametrize("memory", [None, 3e8])
def test_a_box_without_points_is_one_line(
    knot: PointCloud, tmp_path: Path, suffix: str, memory: float | None
) -> None:
    points = tmp_path / f"knot{suffix}"
    write_points(points, knot)
    crop = Crop(box=(100.0, 100.0, 100.0, 110.0, 110.0, 110.0))
    job = JobSettings(
        points=points, output=str(tmp_path / "none.ply"), crop=crop, backend="serial",
        max_memory=memory,
    )  # fmt: skip
    with pytest.raises(InputError, match=r"no points in the box from 100 100 100 to 110") as found:
        run_job(job, Progress())
    assert "lie from -1" in found.value.advice
    assert not (tmp_path / "none.ply").exists()


def test_a_box_beside_the_surface_is_one_line(knot: PointCloud) -> None:
    with pytest.raises(InputError, match="no surface in the box"):
        package.reconstruct(knot, box=(17.0, -10, -10, 30, 10, 10), executor="serial")


def test_a_mesh_ends_on_a_polygon_as_if_the_whole_had_been_meshed(
    knot: PointCloud, tmp_path: Path
) -> None:
    path = tmp_path / "scan.ply"
    write_points(path, PointCloud(knot.positions + ON_A_MAP, knot.normals))
    shape = shapely.Polygon(
        [(2, -6), (15, -3), (9, 8), (7, 2), (3, 5)], [[(9, -2), (11, 0), (9, 1)]]
    )
    on_map = shapely.transform(shape, lambda places: places + ON_A_MAP[:2])
    whole = package.reconstruct(path, executor="serial")
    cell = whole.facts["step"]
    mesh = package.reconstruct(path, polygon=on_map.wkt, executor="serial", voxel_size=cell)
    corners = shapely.points(np.array(mesh.vertices)[:, :2])
    assert shapely.distance(on_map, corners).max() < 1e-6
    assert (shapely.distance(on_map.boundary, corners) < 1e-6).sum() > 100
    inside = Prism(on_map).find(np.array(whole.vertices))
    places = sample(np.array(mesh.vertices), np.array(mesh.faces), 400_000)
    distance, _ = cKDTree(places).query(np.array(whole.vertices)[inside])
    assert np.sqrt((distance**2).mean()) < 0.07 * whole.facts["spacing"]


def test_points_in_a_polygon_are_the_same_for_all_workers(knot: PointCloud, tmp_path: Path) -> None:
    path, outline = tmp_path / "scan.ply", tmp_path / "part.wkt"
    write_points(path, knot)
    outline.write_text("POLYGON ((2 -6, 15 -3, 9 8, 7 2, 3 5, 2 -6))")
    crop = make_crop(polygon=outline)
    job = JobSettings(
        points=path, output=str(tmp_path / "mesh.ply"), crop=crop, backend="zmq", workers=2,
        max_memory=3e8,
    )  # fmt: skip
    run_job(job, Progress())
    memory = replace(job, output=str(tmp_path / "same.ply"), max_memory=None, backend="serial",
                     workers=1)  # fmt: skip
    run_job(memory, Progress())
    assert (tmp_path / "mesh.ply").read_bytes() == (tmp_path / "same.ply").read_bytes()


def test_points_support_what_is_left(knot: PointCloud) -> None:
    mesh = package.reconstruct(knot, box=(0, -20, -10, 20, 20, 10), executor="serial")
    assert not mesh.facts["open"]  # closed beyond the box, by guesswork, which is cut off
    assert mesh.facts["support"]["share"] == 1.0


def test_classes_are_left_out_of_files_and_arrays(tmp_path: Path) -> None:
    knot = package.simulate("knot", points=6_000)
    random = np.random.default_rng(3)
    leaves = knot.positions[:2_000] + random.normal(0.0, 2.0, (2_000, 3))
    classes = np.repeat(np.array([6, 5], np.uint8), [6_000, 2_000])
    both = PointCloud(
        np.concatenate([knot.positions, leaves]), attributes={"classification": classes}
    )
    path, alone = tmp_path / "both.ply", tmp_path / "alone.ply"
    write_points(path, both)
    write_points(alone, PointCloud(knot.positions))
    of_knot = package.reconstruct(alone, executor="serial", attributes="none")
    bare = package.reconstruct(PointCloud(knot.positions), executor="serial", attributes="none")
    of_file = package.reconstruct(path, classes=[6], executor="serial", attributes="none")
    of_cloud = package.reconstruct(both, not_classes=[5], executor="serial", attributes="none")
    assert np.array_equal(of_file.vertices, of_knot.vertices)
    assert np.array_equal(of_cloud.vertices, bare.vertices)
