"""Horizontal feet with vertical metres: the surface is that of true shapes, in the file's numbers.

A ball of 30 feet, whose heights the file gives in metres.
"""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from directions import random_directions
from little_memory import leave_little_memory

from hpcapp.applications.points.info import describe_file
from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.attributes.choice import parse_attributes
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.steps.report_page import show_files
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_mesh, read_points, write_points
from hpcapp.io.crs import Crs
from hpcapp.io.points.inputs import gather_points
from hpcapp.progress import Progress

RADIUS = 30.0  # feet
METRES = 0.3048  # of a foot
CENTRE = np.array([2_000_000.0, 500_000.0, 100.0])  # feet, feet, metres
SUFFIXES = (".ply", ".tiles", ".obj", ".off", ".stl", ".glb", ".vtp", ".3mf")


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directions = random_directions(12_000, 4)
    upright = directions * (1.0, 1.0, METRES)  # in feet and metres
    normals = directions / (1.0, 1.0, METRES)
    path = tmp_path_factory.mktemp("feet") / "ball.ply"
    cloud = PointCloud(RADIUS * upright + CENTRE, normals, attributes={"row": directions[:, 2]})
    write_points(path, cloud, "EPSG:2229", "ft", height_unit="m")
    return path


def reconstruct(points: Path, output: Path, **settings: object) -> dict[str, object]:
    job = JobSettings(points, str(output), grid=40, backend="serial", **settings)  # type: ignore[arg-type]
    return run_job(job, Progress())


def unit_vectors(vertices: FloatArray) -> FloatArray:
    """Directions from the centre of the ball, of unit length where a vertex is on the ball."""
    directions: FloatArray = (vertices - CENTRE) / (RADIUS * np.array([1.0, 1.0, METRES]))
    return directions


def _read_origin(path: Path) -> FloatArray:
    """What a file beside a mesh, or a folder of tiles, says was subtracted."""
    return np.array(json.loads(path.with_name(f"{path.name}.origin.json").read_text())["origin"])


def read_places(path: Path) -> list[FloatArray]:
    """Vertices in the file's own coordinates, of each file that was written."""
    if path.suffix == ".tiles":
        return [place for tile in sorted(path.iterdir()) for place in read_places(tile)]
    if path.suffix == ".3mf":
        model = zipfile.ZipFile(path).read("3D/3dmodel.model").decode()
        rows = np.array(re.findall(r'<vertex x="(.*)" y="(.*)" z="(.*)"/>', model), np.float64)
        (text,) = re.findall(r'transform="(.*?)"', model)
        transform = np.array(text.split(), np.float64)
        assert 'unit="foot"' in model  # all of it, so that heights are scaled
        places = (rows @ transform[:9].reshape(3, 3) + transform[9:]) * (1.0, 1.0, METRES)
        return [places + _read_origin(path)]
    mesh: Mesh = read_mesh(path)
    return [mesh.vertices + mesh.origin]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_mesh_lies_on_its_cloud_in_any_format(suffix: str, ball: Path, tmp_path: Path) -> None:
    output = tmp_path / f"mesh{suffix}"
    report = reconstruct(ball, output)
    assert report["watertight"]
    for places in read_places(output):
        lengths = np.linalg.norm(unit_vectors(places), axis=1)
        assert np.abs(lengths - 1.0).max() < 0.02


def test_normals_and_attributes_of_vertices(ball: Path, tmp_path: Path) -> None:
    output = tmp_path / "mesh.ply"
    reconstruct(ball, output, attributes=parse_attributes("normals,row,support"))
    mesh = read_mesh(output)
    assert mesh.normals is not None
    directions = unit_vectors(mesh.vertices + mesh.origin)
    true = directions / (1.0, 1.0, METRES)
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    assert (mesh.normals * true).sum(axis=1).min() > 0.95
    assert np.abs(mesh.attributes["row"] - directions[:, 2]).max() < 0.1
    assert mesh.attributes["support"].max() < 6.0


def test_a_mesh_in_memory_gets_its_heights_again() -> None:
    slope = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    mesh = Mesh(slope, np.array([[0, 1, 2]]), np.array([5.0, 6.0, 7.0]))
    nothing = PointCloud(np.empty((0, 3)))
    carrying = Carrying(nothing, has_normals=True, crs=Crs(None, "ft", "m"))
    own = carrying.to_mesh(mesh)
    assert own.vertices[:, 2] == pytest.approx([0.0, METRES, 0.0])
    assert own.origin == pytest.approx([5.0, 6.0, 7.0 * METRES])
    assert own.normals is not None
    assert np.abs(own.normals @ (own.vertices[1:] - own.vertices[0]).T).max() < 1e-12
    assert np.linalg.norm(own.normals, axis=1) == pytest.approx(np.ones(3))


@pytest.mark.parametrize("suffix", [".ply", ".tiles"])
def test_a_cloud_in_a_folder_gives_the_same_mesh(
    suffix: str, ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reconstruct(ball, tmp_path / "whole.ply")
    leave_little_memory(monkeypatch, 3_000)
    output = tmp_path / f"parts{suffix}"
    report = reconstruct(ball, output, temp_dir=str(tmp_path / "room"))
    assert report["tiles"] != 1
    if suffix == ".ply":
        assert output.read_bytes() == (tmp_path / "whole.ply").read_bytes()
    for places in read_places(output):
        assert np.abs(np.linalg.norm(unit_vectors(places), axis=1) - 1.0).max() < 0.02


@pytest.mark.parametrize("suffix", [".ply", ".tiles", ".3dtiles"])
def test_parts_lie_where_they_are_asked_for(
    suffix: str, ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_little_memory(monkeypatch, 3_000)
    output, near = tmp_path / f"parts{suffix}", tuple((CENTRE - 7.0).tolist())
    report = reconstruct(ball, output, temp_dir=str(tmp_path / "room"), origin=near)
    assert report["origin"] == _read_origin(output).tolist() == (CENTRE - 7.0).tolist()
    if suffix == ".3dtiles":
        root = json.loads((output / "tileset.json").read_text())["root"]
        assert np.abs(np.array(root["transform"][12:15]) - 7.0).max() < 1.0
        return
    for places in read_places(output):
        if suffix == ".tiles":
            places = places + _read_origin(output)
        assert np.abs(np.linalg.norm(unit_vectors(places), axis=1) - 1.0).max() < 0.02


@pytest.mark.parametrize("suffix", [".ply", ".tiles"])
def test_who_writes_parts_says_what_coordinates_mean(
    suffix: str, ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of points in feet alone parts are written where they are, which no heights are changed in."""
    cloud, feet = read_points(ball), tmp_path / "feet.ply"
    write_points(feet, PointCloud(cloud.positions, cloud.normals), "EPSG:2229", "ft")
    reconstruct(feet, tmp_path / "whole.ply")
    leave_little_memory(monkeypatch, 3_000)
    output = tmp_path / f"parts{suffix}"
    reconstruct(feet, output, temp_dir=str(tmp_path / "room"))
    written = [output] if suffix == ".ply" else sorted(output.iterdir())
    for file in written:
        assert b"comment unit ft\ncomment crs EPSG:2229\n" in file.read_bytes()[:200]
    if suffix == ".ply":
        assert output.read_bytes() == (tmp_path / "whole.ply").read_bytes()


def test_a_viewpoint_is_in_the_coordinates_of_the_file(ball: Path, tmp_path: Path) -> None:
    """From its middle the ball is a room; a place that far above, in feet, would be outside."""
    output = tmp_path / "mesh.ply"
    x, y, z = CENTRE.tolist()
    inside = (x, y, z + 0.5 * RADIUS * METRES)
    reconstruct(ball, output, normals="estimate", viewpoint=(inside,))
    mesh = read_mesh(output)
    corners = (unit_vectors(mesh.vertices + mesh.origin))[mesh.faces]
    volume = np.linalg.det(corners).sum() / 6.0
    assert volume < -3.0  # of a unit ball: 4.19, inside out


def test_one_line_says_so_and_info_shows_the_numbers_of_the_file(ball: Path) -> None:
    facts, findings, _ = describe_file(open_points(ball))
    assert [line for line in findings.lines() if "multiplied by 3.2808" in line]
    extent = np.array(facts["extent"])
    assert extent == pytest.approx(2 * RADIUS * np.array([1.0, 1.0, METRES]), rel=0.01)
    assert (facts["unit"], facts["height_unit"]) == ("ft", "m")


def test_spacing_of_info_is_that_of_the_job(ball: Path, tmp_path: Path) -> None:
    facts, _, _ = describe_file(open_points(ball))
    assert facts["spacing"] == reconstruct(ball, tmp_path / "mesh.ply")["spacing"]


def test_several_files_keep_their_units(ball: Path, tmp_path: Path) -> None:
    twin = tmp_path / "twin.ply"
    twin.write_bytes(ball.read_bytes())
    with gather_points([str(ball), str(twin)]) as joined:
        source = open_points(joined)
        assert source.frame.height_scale == pytest.approx(1.0 / METRES)


def test_points_are_written_in_the_coordinates_of_the_file(ball: Path, tmp_path: Path) -> None:
    pytest.importorskip("laspy")
    source, path = open_points(ball), tmp_path / "ball.las"
    cloud = read_points(ball)
    write_points(path, cloud, source.crs, source.unit, height_unit=source.height_unit)
    again = open_points(path)
    assert (again.unit, again.height_unit) == ("ft", "m")
    near = again.isotropic()
    (own,), (scaled,) = again.chunks(20_000), near.chunks(20_000)
    assert own.positions == pytest.approx(cloud.positions + cloud.origin, abs=1e-3)
    assert scaled.positions[:, 2] == pytest.approx(own.positions[:, 2] / METRES)


def test_a_page_made_of_files_is_undistorted(ball: Path, tmp_path: Path) -> None:
    output = tmp_path / "mesh.ply"
    report = reconstruct(ball, output)
    shown = show_files(output, ball, json.loads(json.dumps(report)))
    extent = np.ptp(shown.mesh.vertices, axis=0)
    assert extent == pytest.approx(np.full(3, 2 * RADIUS), rel=0.03)
    assert np.ptp(shown.points.positions, axis=0) == pytest.approx(extent, rel=0.03)
    assert shown.distances.max() < 0.1 * RADIUS
