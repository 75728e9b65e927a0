"""Points on the faces of meshes: even, and taken unasked where vertices do not stand for them."""

import gzip
from pathlib import Path

import numpy as np
import pytest
import shared_data

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import open_points, read_mesh, read_points, read_whole, write_mesh
from hpcapp.io.points.inputs import gather_points
from hpcapp.io.points.mesh_samples import SAMPLED, are_vertices_few, sample_faces
from hpccomponent.errors import InputError


def _extrude(corners: int) -> Mesh:
    """Return a bar of 8 by 5 by 2 whose upright edges are rounded by so many corners each."""
    turns = np.add.outer(np.pi / 2 * np.arange(4), np.linspace(0, np.pi / 2, corners)).ravel()
    middles = np.repeat([[3.5, 2.0], [-3.5, 2.0], [-3.5, -2.0], [3.5, -2.0]], corners, axis=0)
    plan = middles + 0.5 * np.column_stack([np.cos(turns), np.sin(turns)])
    n, i, k = len(plan), np.arange(len(plan)), np.arange(1, len(plan) - 1)
    j, top = (i + 1) % n, np.full(len(k), n)
    faces = [(i, j, j + n), (i, j + n, i + n), (top - n, k + 1, k), (top, k + n, k + n + 1)]
    vertices = np.vstack([np.insert(plan, 2, height, axis=1) for height in (0.0, 2.0)])
    return Mesh(vertices, np.vstack([np.column_stack(corner) for corner in faces]))


def _make_grid(step_y: float, cells: int = 30) -> Mesh:
    """Return a sheet of even faces, as long as they are wide at a step of 1."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(cells + 1.0), np.arange(cells + 1.0)))
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = first, first + 1, first + cells + 2, first + cells + 1
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Mesh(np.column_stack([x, step_y * y, np.sin(x)]), faces)


def test_the_same_sample_comes_twice() -> None:
    first, second = (sample_faces(_extrude(2), 100).positions for _ in range(2))
    np.testing.assert_array_equal(first, second)
    margins = np.abs(first - (0, 0, 1)) - (4.0, 2.5, 1.0)
    assert margins.max() < 1e-12


def test_a_mesh_without_area_has_no_sample() -> None:
    with pytest.raises(InputError, match="no area"):
        sample_faces(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])), 10)


@pytest.mark.parametrize(
    ("mesh", "are_few"),
    [
        (_extrude(13), True),
        (_extrude(200), True),
        (_make_grid(1.0, cells=13), True),
        (_make_grid(1.0, cells=15), False),
        (_make_grid(1.0), False),
        (_make_grid(3.0), False),
        (_make_grid(8.0), True),
    ],
)
def test_vertices_are_few_where_faces_are_larger_than_their_distance(
    mesh: Mesh, are_few: bool
) -> None:
    assert are_vertices_few(mesh) == are_few


@pytest.mark.parametrize(
    ("name", "are_few"),
    [
        ("bunny_zipper_mesh.ply", False),
        ("tuning/meshes/laurana.ply", False),
        ("tuning/meshes/daratech.ply", False),
        ("real/ply/Wuson.ply", True),
        ("tuning/meshes/screw.ply", True),
    ],
)
def test_meshed_scans_have_vertices_enough(name: str, are_few: bool) -> None:
    assert are_vertices_few(read_mesh(shared_data.shared(name))) == are_few


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".off", ".ply", ".glb", ".vtp"])
def test_a_surface_is_made_of_points_on_faces_where_vertices_are_few(
    tmp_path: Path, suffix: str
) -> None:
    path, bar = tmp_path / f"a{suffix}", _extrude(13)
    write_mesh(path, bar)
    with gather_points([str(path)], for_surface=True) as gathered:
        source = open_points(gathered)
        cloud = read_whole(source)
    assert len(cloud) == SAMPLED
    assert any(f"{SAMPLED} points" in line for line in source.findings.warnings)
    inner = np.abs(cloud.positions + cloud.origin).max(axis=0)
    np.testing.assert_allclose(np.sort(inner), [2, 2.5, 4], atol=0.01)
    with gather_points([str(path)], 500, for_surface=True) as gathered:
        asked = open_points(gathered)
        assert len(read_whole(asked)) == 500
    assert not asked.findings.warnings


@pytest.mark.parametrize("packed", [False, True])
def test_a_meshed_scan_is_read_where_it_is(tmp_path: Path, packed: bool) -> None:
    path, sheet = tmp_path / "a.ply", _make_grid(1.0)
    write_mesh(path, sheet)
    if packed:
        path = tmp_path / "b.ply.gz"
        path.write_bytes(gzip.compress((tmp_path / "a.ply").read_bytes()))
    with gather_points([str(path)], for_surface=True) as gathered:
        assert len(read_points(gathered)) == len(sheet.vertices)
