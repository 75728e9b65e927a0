"""What a mesh tells of itself, and where it can go."""

from __future__ import annotations

import html
import pickle
import shutil
import sys
import tempfile
import webbrowser
from pathlib import Path

import numpy as np
import pytest
from spheres import make_sphere

import hpcapp
from hpcapp.geometry.points import PointCloud
from hpccomponent.errors import HpcError, InputError, MissingLibraryError, OutputError, UsageError

CORNERS = np.array([[0.0, 0, 0], [2.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_a_notebook_gets_a_frame_with_the_page() -> None:
    shown = hpcapp.Mesh(CORNERS, FACES)._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    page = html.unescape(shown.split('"')[1])
    assert page.startswith("<!DOCTYPE html>")
    assert "4 vertices, 4 faces" in page


def test_show_opens_the_page_that_it_has_written(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []

    def open_browser(uri: str) -> bool:
        opened.append(uri)
        return True

    monkeypatch.setattr(webbrowser, "open", open_browser)
    path = hpcapp.Mesh(CORNERS, FACES).show(PointCloud(CORNERS))
    assert opened == [path.as_uri()]
    assert path.is_relative_to(temporary)
    assert 'id="show-points"' in path.read_text()
    shutil.rmtree(path.parent)


def test_a_machine_without_a_browser_gets_the_path(
    temporary: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    path = hpcapp.Mesh(CORNERS, FACES).show()
    assert str(path) in caplog.text


def test_what_is_read_and_what_is_reconstructed_can_be_shown(tmp_path: Path) -> None:
    hpcapp.Mesh(CORNERS, FACES).save(tmp_path / "a.ply")
    read = hpcapp.read_mesh(tmp_path / "a.ply")
    assert isinstance(read, hpcapp.Mesh)
    np.testing.assert_array_equal(read.faces, FACES)
    assert isinstance(hpcapp.reconstruct(make_sphere(2000), grid=16), hpcapp.Mesh)


FAR = np.array([5_400_000.0, 400_000.0, 100.0])


@pytest.fixture(scope="module")
def torus() -> hpcapp.Mesh:
    return hpcapp.reconstruct(
        hpcapp.simulate("torus", points=4000), grid=48, attributes="auto,normals,support"
    )


@pytest.mark.parametrize("shift", [np.zeros(3), FAR])
def test_a_mesh_measures_itself_wherever_it_is(shift: np.ndarray) -> None:
    mesh = hpcapp.Mesh(CORNERS + shift, FACES)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(2.0 / 6.0)
    assert mesh.area == pytest.approx(0.5 * (2.0 + 1.0 + 2.0 + 3.0))
    np.testing.assert_array_equal(mesh.bounds, shift + np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 1.0]]))
    np.testing.assert_array_equal(mesh.vertices, CORNERS + shift)
    assert repr(mesh) == "Mesh(4 vertices, 4 faces, watertight, 2 x 1 x 1)"


def test_what_is_open_has_no_volume() -> None:
    mesh = hpcapp.Mesh(CORNERS, FACES[:3])
    assert not mesh.is_watertight
    assert np.isnan(mesh.volume)
    assert "not watertight" in repr(mesh)


def test_a_mesh_without_anything_can_still_be_asked() -> None:
    mesh = hpcapp.Mesh(np.empty((0, 3)), np.empty((0, 3), int))
    assert (mesh.area, mesh.is_watertight) == (0.0, False)
    assert np.isnan(mesh.bounds).all()
    assert repr(mesh).startswith("Mesh(0 vertices, 0 faces, not watertight")


def test_arrays_cannot_be_written_to(torus: hpcapp.Mesh) -> None:
    assert torus.normals is not None
    for array in (torus.vertices, torus.faces, torus.normals, torus.bounds, torus.origin,
                  torus.attributes["support"]):  # fmt: skip
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_a_mesh_far_from_zero_is_written_and_read_as_it_is(tmp_path: Path) -> None:
    mesh = hpcapp.Mesh(CORNERS + FAR + 0.125, FACES)
    for name in ("a.ply", "a.obj", "a.glb"):
        mesh.save(tmp_path / name)
        read = hpcapp.read_mesh(tmp_path / name)
        assert np.abs(read.bounds - mesh.bounds).max() < 1e-6
        assert np.abs(read.vertices - mesh.origin).max() < 10.0


def test_what_cannot_lie_beside_a_mesh_is_refused_before_it_is_written(tmp_path: Path) -> None:
    (tmp_path / "a.glb.origin.json").mkdir()
    with pytest.raises(OutputError, match=r"a.glb.origin.json: is not a file; give another name"):
        hpcapp.Mesh(CORNERS + FAR, FACES).save(tmp_path / "a.glb")
    assert [path.name for path in tmp_path.iterdir()] == ["a.glb.origin.json"]


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ((CORNERS, FACES + 1), "faces has corners from 1 to 4; give rows of the 4 vertices"),
        ((CORNERS, FACES[:, :2]), "faces holds int64 of the shape"),
        ((CORNERS, FACES.astype(float)), "faces holds float64"),
        ((CORNERS[:, :2], FACES), "vertices has the shape"),
        ((CORNERS * np.nan, FACES), "vertices has 4 of 4 rows with NaN"),
    ],
)
def test_arrays_that_are_no_mesh_are_refused(
    arrays: tuple[np.ndarray, np.ndarray], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        hpcapp.Mesh(*arrays)


def test_normals_are_one_for_each_vertex() -> None:
    with pytest.raises(InputError, match="normals has 3 rows, not 4"):
        hpcapp.Mesh(CORNERS, FACES, normals=CORNERS[:3])


def test_the_report_tells_of_the_job(torus: hpcapp.Mesh, tmp_path: Path) -> None:
    torus.report(tmp_path / "job.html")
    page = (tmp_path / "job.html").read_text()
    assert "Distance to the points" in page
    assert "Decided" in page
    assert torus.facts["watertight"] is True
    assert torus.facts["grid"] == 48


def test_a_mesh_of_no_job_reports_itself(tmp_path: Path) -> None:
    mesh = hpcapp.Mesh(CORNERS, FACES)
    mesh.report(tmp_path / "mesh.html")
    assert "4 vertices, 4 faces" in (tmp_path / "mesh.html").read_text()
    assert dict(mesh.facts) == {}
    with pytest.raises(UsageError, match="txt: is no page") as caught:
        mesh.report(tmp_path / "mesh.txt")
    assert "--" not in str(caught.value)


def test_a_picture_is_a_small_png(torus: hpcapp.Mesh, tmp_path: Path) -> None:
    torus.picture(tmp_path / "torus.png", size=64)
    assert (tmp_path / "torus.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_a_mesh_can_be_pickled(torus: hpcapp.Mesh, tmp_path: Path) -> None:
    copy = pickle.loads(pickle.dumps(torus))  # noqa: S301 - our own
    np.testing.assert_array_equal(copy.vertices, torus.vertices)
    assert copy.facts == torus.facts


def test_trimesh_gets_the_same_mesh(torus: hpcapp.Mesh) -> None:
    pytest.importorskip("trimesh", reason="trimesh is not installed")
    copy = torus.to_trimesh()
    np.testing.assert_array_equal(copy.vertices, torus.vertices)
    np.testing.assert_array_equal(copy.faces, torus.faces)
    assert copy.is_watertight
    assert copy.volume == pytest.approx(torus.volume)
    assert copy.area == pytest.approx(torus.area)
    np.testing.assert_array_equal(copy.bounds, torus.bounds)
    np.testing.assert_array_equal(copy.vertex_attributes["support"], torus.attributes["support"])
    copy.vertices[0] = 0.0  # it is a copy
    assert torus.vertices[0].any()


def test_open3d_gets_the_same_mesh(torus: hpcapp.Mesh) -> None:
    pytest.importorskip("open3d", reason="open3d is not installed")
    copy = torus.to_open3d()
    np.testing.assert_array_equal(np.asarray(copy.vertices), torus.vertices)
    np.testing.assert_array_equal(np.asarray(copy.triangles), torus.faces)
    np.testing.assert_array_equal(np.asarray(copy.vertex_normals), torus.normals)
    assert copy.is_watertight()
    assert copy.get_volume() == pytest.approx(torus.volume)


def test_pyvista_gets_the_same_mesh(torus: hpcapp.Mesh) -> None:
    pytest.importorskip("pyvista", reason="pyvista is not installed")
    copy = torus.to_pyvista()
    np.testing.assert_array_equal(copy.points, torus.vertices)
    np.testing.assert_array_equal(copy.regular_faces, torus.faces)
    np.testing.assert_array_equal(copy.point_data["support"], torus.attributes["support"])
    assert copy.volume == pytest.approx(torus.volume)
    assert copy.is_manifold


@pytest.mark.parametrize("package", ["trimesh", "open3d", "pyvista"])
def test_a_package_that_is_missing_is_named(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)  # as if it were not installed
    mesh = hpcapp.Mesh(CORNERS, FACES)
    with pytest.raises(ImportError, match=f"pip install {package}") as caught:
        getattr(mesh, f"to_{package}")()
    assert isinstance(caught.value, MissingLibraryError)
    assert isinstance(caught.value, HpcError)


def test_fewer_faces_lie_where_the_mesh_does() -> None:
    """Far from zero, too."""
    points = np.random.default_rng(0).normal(size=(8_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    middle = np.array([512_000.0, 5_403_000.0, 120.0])
    mesh = hpcapp.reconstruct(points + middle, points, grid=32)
    light = mesh.simplify(faces=500)
    assert light.is_watertight
    assert 400 < len(light.faces) <= 500 < len(mesh.faces)
    np.testing.assert_allclose(np.linalg.norm(light.vertices - middle, axis=1), 1.0, atol=0.03)
    with pytest.raises(UsageError, match="no target"):
        mesh.simplify()
