"""Scans without normals as people have them: right side out, open or closed as they were seen.

They are in the folders `cases` and `raw` of the shared scans.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from shared_data import shared

from hpcapp.cli import main
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io import open_points, read_mesh, read_whole

pytestmark = pytest.mark.slow


def _run(name: str, place: Path, *options: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(["reconstruct", str(shared(name)), "-o", str(place), "--backend", "serial", *options])
    return int(left.value.code or 0)


def _mesh(name: str, folder: Path, *options: str) -> Mesh:
    assert _run(name, folder / "mesh.ply", *options) == 0
    return read_mesh(folder / "mesh.ply")


def _crosses(mesh: Mesh) -> FloatArray:
    """Return the normals of the faces, as long as twice their areas."""
    corners = mesh.vertices[mesh.faces]
    crosses: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return crosses


def _borders(mesh: Mesh) -> int:
    sides = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    counts = np.unique(sides, axis=0, return_counts=True)[1]
    return int(np.count_nonzero(counts == 1))


@pytest.mark.parametrize(
    "name",
    [
        "cases/pdal_4_6_crop.las",
        "cases/dense_forest.laz",
        "cases/dense_forest_silent.laz",
        "raw/airborne/forest_dense.laz",
        "raw/airborne/forest_light.laz",
        "raw/airborne/forest_medium.laz",
        "raw/airborne/town_lake.laz",
    ],
)
def test_ground_from_the_air_faces_up_under_trees_too(name: str, tmp_path: Path) -> None:
    mesh = _mesh(name, tmp_path)
    points = read_whole(open_points(shared(name)))
    ground = points.positions[points.attributes["classification"] == 2] + points.origin
    middles = mesh.vertices[mesh.faces].mean(axis=1) + mesh.origin
    nearest = cKDTree(middles).query(ground)[1]
    assert (_crosses(mesh)[nearest, 2] > 0.0).mean() > 0.99
    assert _borders(mesh)


@pytest.mark.parametrize(
    ("name", "axis"),
    [
        ("terrain_z_up.xyz", 2),
        ("terrain_y_up.xyz", 1),
        ("flat_terrain_1000.xyz", 2),
        ("flat_terrain_2000.xyz", 2),
        ("pdal_autzen-utm.pcd", 2),
    ],
)
def test_terrain_is_one_sheet_on_one_side(name: str, axis: int, tmp_path: Path) -> None:
    mesh = _mesh(f"cases/{name}", tmp_path)
    along = _crosses(mesh)[:, axis]
    assert np.abs(along).sum() > 0.0
    upwards = np.maximum(along, 0.0).sum() / np.abs(along).sum()
    # Whether y or -y is up, nothing tells.
    assert (upwards if axis == 2 else max(upwards, 1.0 - upwards)) > 0.999
    assert _borders(mesh)


def test_a_cavity_faces_inwards(tmp_path: Path) -> None:
    mesh = _mesh("cases/hollow_ball.xyz", tmp_path)
    first = mesh.vertices[mesh.faces[:, 0]] - mesh.vertices.mean(axis=0)
    volume = np.einsum("ij,ij->", first, _crosses(mesh)) / 6.0
    assert not _borders(mesh)
    assert abs(volume - 3.67) < 0.05


@pytest.mark.parametrize("name", ["furnished_y_down", "flat_two_rooms", "chair_y_up"])
def test_rooms_face_who_scanned_them(name: str, tmp_path: Path) -> None:
    mesh = _mesh(f"raw/rooms/{name}.ply", tmp_path)
    middles, crosses = mesh.vertices[mesh.faces].mean(axis=1), _crosses(mesh)
    inwards = np.einsum("ij,ij->i", crosses, np.median(mesh.vertices, axis=0) - middles)
    assert (inwards > 0.0).mean() > 0.5  # walls, floor and ceiling, less furniture
    assert _borders(mesh)


@pytest.mark.parametrize("name", ["bumpy_cube", "boot", "anchor"])
def test_what_stood_on_a_table_is_closed_and_faces_outwards(name: str, tmp_path: Path) -> None:
    mesh = _mesh(f"raw/objects/{name}__table.ply", tmp_path)
    first = mesh.vertices[mesh.faces[:, 0]] - mesh.vertices.mean(axis=0)
    assert np.einsum("ij,ij->", first, _crosses(mesh)) > 0.0
    assert not _borders(mesh)


@pytest.mark.parametrize("cameras", ["images.txt", "transforms_one_line.json"])
def test_a_ball_on_a_table_faces_its_photographers(cameras: str, tmp_path: Path) -> None:
    mesh = _mesh("cases/table_ball.xyz", tmp_path, "--viewpoint", str(shared(f"cases/{cameras}")))
    truth = np.load(shared("cases/truth_ball.npy")).astype(np.float64)
    middles = mesh.vertices[mesh.faces].mean(axis=1) + mesh.origin
    nearest = cKDTree(middles).query(truth[:, :3])[1]
    agreement = np.einsum("ij,ij->i", _crosses(mesh)[nearest], truth[:, 3:])
    assert (agreement > 0.0).mean() > 0.99


def test_particles_are_no_surface(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("cases/fluid_particles.xyz", tmp_path / "mesh.ply") == 3
    assert "fill a volume" in capsys.readouterr().err
    assert not (tmp_path / "mesh.ply").exists()


def test_tiles_of_an_open_scan_give_the_same_bytes(tmp_path: Path) -> None:
    """Cells of several sizes meet at the seams of these, and copies of bricks reach far."""
    for name, options in (("one", ()), ("two", ("--backend", "zmq", "--workers", "2"))):
        assert _run("raw/airborne/hills.laz", tmp_path / f"{name}.ply", *options) == 0
    assert (tmp_path / "one.ply").read_bytes() == (tmp_path / "two.ply").read_bytes()
