import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shared_data import shared
from small_files import NEEDED

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import (
    check_writable,
    drop_unusable,
    read_mesh,
    read_points,
    write_mesh,
    write_points,
)
from hpcapp.io.crs import Crs
from hpcapp.io.meshes.mesh_stream import as_stream
from hpccomponent.errors import InputError, MissingLibraryError, OutputError, UsageError

Make = Callable[..., Path]
MESH_SUFFIXES = [".ply", ".obj", ".off", ".stl", ".PLY", ".Obj"]
POINT_SUFFIXES = [".ply", ".npz", ".xyz", ".txt", ".asc", ".pts"]


def corners(mesh: Mesh) -> np.ndarray:
    """Every triangle by the places of its corners, in a fixed order."""
    triangles = (mesh.vertices + mesh.origin)[mesh.faces]
    first = [np.lexsort(t.T[::-1])[0] for t in triangles]
    turned = np.array([np.roll(t, -i, axis=0) for t, i in zip(triangles, first, strict=True)])
    return np.array(sorted(turned.reshape(-1, 9).tolist()))


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_a_mesh_comes_back_in_every_format(tmp_path: Path, tetrahedron: Mesh, suffix: str) -> None:
    write_mesh(tmp_path / f"mesh{suffix}", tetrahedron)
    again = read_mesh(str(tmp_path / f"mesh{suffix}"))
    assert again.vertices.shape == (4, 3)  # STL's corners are one vertex again
    assert (corners(again) == corners(tetrahedron)).all()


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off"])
def test_a_georeferenced_mesh_comes_back(tmp_path: Path, tetrahedron: Mesh, suffix: str) -> None:
    fine = Mesh(tetrahedron.vertices / 7, tetrahedron.faces, np.array([4.5e5, 5.4e6, 300.0]))
    write_mesh(tmp_path / f"mesh{suffix}", fine)
    again = read_mesh(tmp_path / f"mesh{suffix}")
    assert again.origin.any()
    assert np.abs(corners(again) - corners(fine)).max() < 1e-6


@pytest.mark.parametrize("suffix", POINT_SUFFIXES)
def test_a_cloud_comes_back_in_every_format(tmp_path: Path, cloud: PointCloud, suffix: str) -> None:
    write_points(tmp_path / f"cloud{suffix}", cloud)
    again = read_points(tmp_path / f"cloud{suffix}")
    assert (again.positions == cloud.positions).all()
    np.testing.assert_array_equal(again.normals, cloud.normals)
    np.testing.assert_array_equal(again.colours, cloud.colours)


def test_unknown_suffixes_are_answered_with_the_known(
    tmp_path: Path, cloud: PointCloud, tetrahedron: Mesh
) -> None:
    for call in (
        lambda: read_points(tmp_path / "scan.abc"),
        lambda: write_points(tmp_path / "scan.stl", cloud),
        lambda: read_mesh(tmp_path / "mesh"),
        lambda: write_mesh(tmp_path / "mesh.dae", tetrahedron),
        lambda: check_writable(tmp_path / "mesh.dae"),
        lambda: check_writable(tmp_path / "mesh.obj", "points"),
    ):
        with pytest.raises(UsageError, match=r"suffix.*\.ply, "):
            call()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["missing.ply", "missing.xyz", "folder.ply", "folder.xyz"])
def test_a_file_that_cannot_be_opened_is_bad_input(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "folder.xyz").mkdir()
    with pytest.raises(InputError, match=f"{name}.*(No such|directory|folder|regular file)"):
        read_points(tmp_path / name)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".stl"])
@pytest.mark.parametrize("content", [b"", b"\n", b"junk\0\xff 1 2 3\n" * 20, b"solid x\n"])
def test_what_is_no_mesh_is_refused(make_file: Make, suffix: str, content: bytes) -> None:
    with pytest.raises(InputError, match=suffix):
        read_mesh(make_file(f"bad{suffix}", content))


@pytest.mark.parametrize("suffix", [".ply", ".off", ".stl"])
def test_a_truncated_mesh_is_refused_wherever_it_is_cut(
    make_file: Make, tmp_path: Path, tetrahedron: Mesh, suffix: str
) -> None:
    write_mesh(tmp_path / f"whole{suffix}", tetrahedron)
    whole = (tmp_path / f"whole{suffix}").read_bytes()
    for kept in range(len(whole) - 3):  # an ascii file cut in its last number is another mesh
        with pytest.raises(InputError):
            read_mesh(make_file(f"cut{suffix}", whole[:kept]))


def test_the_stanford_bunny_is_read() -> None:
    scan, truth = shared("bunny_35947.ply"), shared("bunny_zipper_mesh.ply")
    cloud, dropped = drop_unusable(read_points(scan))
    mesh = read_mesh(truth)
    assert len(cloud) == len(mesh.vertices) == 35_947
    assert dropped.total == 0
    assert mesh.faces.shape == (69_451, 3)
    used = np.unique(mesh.faces)  # a vertex without a face is no point of the surface
    assert (read_points(truth).positions == mesh.vertices[used]).all()


@pytest.mark.parametrize(
    ("suffix", "lost"),
    [
        (".ply", None),
        (".glb", None),
        (".vtp", None),
        (".3dtiles", None),
        (".3mf", "no normals, no intensity"),
        (".obj", "no intensity, no gps time, no is <good>, no number, no half"),
        (".off", "no normals, no colours, no intensity"),
        (".stl", "no normals, no colours, no intensity"),
        (".tiles", "no normals of vertices: left out; .ply, .glb, .vtp, .3dtiles hold all"),
    ],
)
def test_what_a_format_does_not_hold_is_said(
    tmp_path: Path,
    painted: Mesh,
    tetrahedron: Mesh,
    caplog: pytest.LogCaptureFixture,
    suffix: str,
    lost: str | None,
) -> None:
    write_mesh(tmp_path / f"mesh{suffix}", painted)
    if lost is None:
        assert not caplog.messages
    else:
        message = caplog.messages[0]
        assert f"mesh{suffix}: {suffix} holds {lost}" in message
    caplog.clear()
    write_mesh(tmp_path / f"plain{suffix}", tetrahedron)
    assert not caplog.messages


LOCAL_FRAME = Crs("EPSG:25832", "m", "ft")


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file, of all files of a folder, or of what is packed in one."""
    if path.is_dir():
        return b"".join(file.read_bytes() for file in sorted(path.iterdir()))
    if path.suffix == ".3mf":
        return zipfile.ZipFile(path).read("3D/3dmodel.model")
    return path.read_bytes()


@pytest.mark.parametrize(
    ("suffix", "said"),
    [
        (".ply", ["comment crs EPSG:25832\n", "comment unit m\n", "comment height_unit ft\n"]),
        (".tiles", ["comment crs EPSG:25832\n", "comment unit m\n", "comment height_unit ft\n"]),
        (".obj", ["# crs EPSG:25832\n", "# unit m\n", "# height_unit ft\n"]),
        (".off", ["# crs EPSG:25832\n", "# unit m\n", "# height_unit ft\n"]),
        (".glb", ['"extras":{"unit":"m","height_unit":"ft","crs":"EPSG:25832"}']),
        (".3dtiles", ['"crs": "EPSG:25832"', '"unit": "m"']),
        (".vtp", ['Name="crs"', "109 0</DataArray>"]),
        (".3mf", ['<model unit="meter"', '"Description">EPSG:25832<']),
    ],
)
def test_a_mesh_says_what_its_coordinates_mean(
    tmp_path: Path,
    tetrahedron: Mesh,
    caplog: pytest.LogCaptureFixture,
    suffix: str,
    said: list[str],
) -> None:
    path = tmp_path / f"mesh{suffix}"
    write_mesh(path, replace(as_stream(tetrahedron), crs=LOCAL_FRAME))
    written = read_bytes(path)
    for text in said:
        assert text.encode() in written
    if suffix not in (".tiles", ".3dtiles", ".3mf"):
        assert (read_mesh(path).vertices == tetrahedron.vertices).all()
    assert not caplog.messages


def test_a_coordinate_system_is_one_line_of_a_header(tmp_path: Path, tetrahedron: Mesh) -> None:
    wild = Crs('PROJCS["a",\n UNIT["metre",1]]\x01\nend_header', "m")
    write_mesh(tmp_path / "mesh.ply", replace(as_stream(tetrahedron), crs=wild))
    assert (read_mesh(tmp_path / "mesh.ply").vertices == tetrahedron.vertices).all()


@pytest.mark.parametrize(
    ("unit", "name", "scale"),
    [
        ("m", "meter", None), ("ft", "foot", None), ("mm", "millimeter", None),
        ("cm", "centimeter", None), ("km", "meter", 1000.0), ("US ft", "meter", 1200 / 3937),
        (None, "millimeter", None), ("degree", "millimeter", None),
    ],
)  # fmt: skip
def test_a_3mf_has_the_unit_of_the_input(
    tmp_path: Path, tetrahedron: Mesh, unit: str | None, name: str, scale: float | None
) -> None:
    write_mesh(tmp_path / "mesh.3mf", replace(as_stream(tetrahedron), crs=Crs(None, unit)))
    model = read_bytes(tmp_path / "mesh.3mf").decode()
    assert f'unit="{name}"' in model
    number = f"{scale or 1.0:.17g}"
    placed = f'transform="{number} 0 0 0 {number} 0 0 0 {number} 0 0 0"'
    assert (placed in model) == (scale is not None)


BOUNDED = [".las", ".e57"]
"""Formats that hold no NaN."""


@pytest.mark.parametrize("suffix", BOUNDED)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_coordinates_that_are_no_numbers(tmp_path: Path, suffix: str, value: float) -> None:
    pytest.importorskip(NEEDED[suffix], reason="its library is not installed")
    with pytest.raises(OutputError, match="NaN or infinite"):
        write_points(tmp_path / f"a{suffix}", PointCloud(np.array([[0, 0, value]])))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", BOUNDED)
def test_points_that_are_no_numbers_are_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, suffix: str
) -> None:
    """An organised cloud has NaN where nothing came back."""
    pytest.importorskip(NEEDED[suffix], reason="its library is not installed")
    positions = np.array([[1, 2, 3], [np.nan] * 3, [4, 5, 6], [7, np.inf, 8]])
    cloud = PointCloud(positions, attributes={"intensity": np.arange(4, dtype=np.uint16)})
    write_points(tmp_path / f"a{suffix}", cloud)
    again = read_points(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(again.positions + again.origin, positions[[0, 2]], atol=1e-6)
    assert again.attributes["intensity"].tolist() == [0, 2]
    assert "dropped 2 NaN or infinite points" in caplog.text


@pytest.mark.parametrize(
    ("suffix", "module", "said"),
    [(".las", "laspy", r"pip install 'laspy\["), (".e57", "pye57.libe57", "pip install 'pye57>")],
)
def test_a_missing_library_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, module: str, said: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingLibraryError, match=said):
        write_points(tmp_path / f"a{suffix}", PointCloud(np.eye(3)))
