"""The command ``view``: pages and pictures of any file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

import hpcapp
from hpcapp.applications.view.command import view
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, write_mesh, write_points
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.pages.picture import write_picture
from hpccomponent.errors import InputError, OutputError, UsageError

CORNERS = np.array([[0.0, 0, 0], [2.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
TETRAHEDRON = Mesh(CORNERS, FACES, np.array([4e5, 5e6, 0.0]))


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(view, list(map(str, words)), catch_exceptions=False)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off", ".glb", ".vtp"])
def test_every_format_of_meshes_has_a_page(tmp_path: Path, suffix: str) -> None:
    write_mesh(tmp_path / f"m{suffix}", TETRAHEDRON)
    done = run(tmp_path / f"m{suffix}", "-o", tmp_path / "p.html", "--no-open")
    assert done.output.strip() == str(tmp_path / "p.html")
    page = (tmp_path / "p.html").read_text()
    assert "4 vertices, 4 faces, watertight" in page
    assert 'id="wireframe"' in page


@pytest.mark.parametrize("suffix", [".ply", ".xyz", ".npz"])
def test_points_have_a_page(tmp_path: Path, suffix: str) -> None:
    cloud = np.random.default_rng(0).normal(size=(50, 3))
    write_points(tmp_path / f"c{suffix}", PointCloud(cloud))
    run(tmp_path / f"c{suffix}", "-o", tmp_path / "p.html", "--no-open")
    page = (tmp_path / "p.html").read_text()
    assert "50 points" in page
    assert 'id="wireframe"' not in page


def test_points_beside_a_mesh_tell_its_distance(tmp_path: Path) -> None:
    write_mesh(tmp_path / "m.ply", TETRAHEDRON)
    write_points(
        tmp_path / "c.ply",
        PointCloud(CORNERS + 0.3, origin=TETRAHEDRON.origin),
    )
    run(tmp_path / "m.ply", "--points", tmp_path / "c.ply", "-o", tmp_path / "p.html", "--no-open")
    page = (tmp_path / "p.html").read_text()
    scene = json.loads(page.split('id="scene">')[1].split("</script>")[0])
    [distance] = [one for one in scene["fields"] if one["name"] == "distance"]
    assert distance["high"] == pytest.approx(0.3 * 3**0.5, abs=0.2)


def test_a_report_is_said_on_the_page(tmp_path: Path) -> None:
    write_mesh(tmp_path / "m.ply", TETRAHEDRON)
    (tmp_path / "r.json").write_text(json.dumps({"noise": 0.125, "warnings": ["!w"]}))
    run(tmp_path / "m.ply", "--report", tmp_path / "r.json", "-o", tmp_path / "p.html", "--no-open")
    page = (tmp_path / "p.html").read_text()
    assert "0.125" in page
    assert "!w" in page


@pytest.mark.parametrize("content", ["", "[1]", "{", "\xff"])
def test_a_report_that_is_none_is_refused(tmp_path: Path, content: str) -> None:
    write_mesh(tmp_path / "m.ply", TETRAHEDRON)
    (tmp_path / "r.json").write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=r"r\.json"):
        run(tmp_path / "m.ply", "--report", tmp_path / "r.json", "-o", tmp_path / "p.html")
    assert not (tmp_path / "p.html").exists()


def test_a_picture_alone_makes_no_page(tmp_path: Path) -> None:
    write_mesh(tmp_path / "m.ply", TETRAHEDRON)
    done = run(tmp_path / "m.ply", "--png", tmp_path / "m.png", "--size", "32", "--eye", "10,5")
    assert not done.output
    assert (tmp_path / "m.png").read_bytes().startswith(b"\x89PNG")
    assert {path.name for path in tmp_path.iterdir()} == {"m.ply", "m.png"}


@pytest.mark.parametrize(
    ("words", "error", "said"),
    [
        (["-o", "p.txt"], UsageError, "ends in .html"),
        (["--png", "p.jpg"], UsageError, "ends in .png"),
        (["-o", "no/p.html"], OutputError, "create the folder"),
        (["--eye", "1,2"], UsageError, "--png"),
    ],
)
def test_what_cannot_be_is_said(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    error: type[Exception],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_mesh("m.ply", TETRAHEDRON)
    with pytest.raises(error, match=said):
        run("m.ply", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["m.ply"]


def test_a_cloud_without_a_place_is_refused(tmp_path: Path) -> None:
    write_points(tmp_path / "c.npz", PointCloud(np.full((5, 3), np.nan)))
    with pytest.raises(InputError):
        run(tmp_path / "c.npz", "-o", tmp_path / "p.html", "--no-open")


@pytest.mark.parametrize(
    "told",
    [
        {"warnings": 5},
        {"stages": {"read": "x"}},
        {"stages": 3},
        {"timeline": {"spans": [1]}},
        {"timeline": 4},
        {"timeline": {"spans": [{"name": "read"}]}},
        {"command": 7},
    ],
)
def test_what_is_no_report_of_a_job_is_refused(tmp_path: Path, told: object) -> None:
    write_mesh(tmp_path / "m.ply", TETRAHEDRON)
    (tmp_path / "r.json").write_text(json.dumps(told))
    words: list[str | Path] = [
        tmp_path / "m.ply",
        "--report",
        tmp_path / "r.json",
        "-o",
        tmp_path / "p.html",
    ]
    with pytest.raises(InputError, match=r"r\.json: is no report of a job"):
        run(*words, "--no-open")
    assert not (tmp_path / "p.html").exists()


@pytest.mark.parametrize("flag", ["--points", "--report"])
def test_what_a_picture_does_not_show_is_refused(tmp_path: Path, flag: str) -> None:
    write_mesh(tmp_path / "m.ply", TETRAHEDRON)
    with pytest.raises(UsageError, match=f"{flag} means nothing to a picture"):
        run(tmp_path / "m.ply", flag, tmp_path / "m.ply", "--png", tmp_path / "p.png")


@pytest.mark.parametrize("eye", ["a,b", "1", "1,2,3", ""])
def test_an_eye_is_two_angles(tmp_path: Path, eye: str) -> None:
    write_mesh(tmp_path / "m.ply", TETRAHEDRON)
    done = run(tmp_path / "m.ply", "--png", tmp_path / "p.png", "--eye", eye)
    assert done.exit_code == 2
    assert "is not two angles" in done.output
    assert not (tmp_path / "p.png").exists()


def test_lengths_have_the_unit_of_the_mesh(tmp_path: Path) -> None:
    page, paths = tmp_path / "p.html", (tmp_path / "bare.ply", tmp_path / "feet.ply")
    for path, crs in zip(paths, (UNKNOWN, Crs("EPSG:2229", "US ft")), strict=True):
        write_mesh(path, replace(as_stream(Mesh(CORNERS, FACES)), crs=crs))
        run(path, "--png", path.with_suffix(".png"), "--size", "200")
    write_points(tmp_path / "c.xyz", PointCloud(CORNERS))
    for words in ((), ("--points", tmp_path / "c.xyz")):
        run(paths[1], *words, "-o", page, "--no-open")
        assert read_scene(page)["unit"] == "US ft"
    for path, unit in zip(paths, (None, "US ft"), strict=True):
        mesh = hpcapp.read_mesh(path)
        mesh.picture(tmp_path / "own.png", size=200)
        write_picture(tmp_path / "truth.png", read_mesh(path), size=200, unit=unit)
        for drawn in (tmp_path / "own.png", path.with_suffix(".png")):
            assert drawn.read_bytes() == (tmp_path / "truth.png").read_bytes()
        mesh.report(page)
        assert read_scene(page)["unit"] == (unit or "")
    assert len({path.with_suffix(".png").read_bytes() for path in paths}) == 2


def read_scene(page: Path) -> dict[str, Any]:
    text = page.read_text().split('id="scene">')[1].split("</script>")[0]
    scene: dict[str, Any] = json.loads(text)
    return scene


def test_lengths_have_the_unit_of_the_points(tmp_path: Path) -> None:
    write_points(tmp_path / "c.e57", PointCloud(CORNERS))  # in metres, as the format has it
    write_mesh(tmp_path / "m.ply", Mesh(CORNERS, FACES))
    page = tmp_path / "p.html"
    for words in ((tmp_path / "c.e57",), (tmp_path / "m.ply", "--points", tmp_path / "c.e57")):
        run(*words, "-o", page, "--no-open")
        scene = read_scene(page)
        assert scene["unit"] == "m"
        assert all(one["unit"] == "m" for one in scene["fields"] if one["name"] == "distance")


def test_a_part_is_shown_of_a_mesh_and_of_its_points(tmp_path: Path) -> None:
    places = np.random.default_rng(0).random((500, 3)) * 10.0
    write_points(tmp_path / "c.ply", PointCloud(places))
    write_mesh(tmp_path / "m.ply", Mesh(CORNERS * 10.0, FACES))
    page, box = tmp_path / "p.html", ("--box", "0,0,0,4.5,4.5,4.5")
    run(tmp_path / "c.ply", *box, "-o", page, "--no-open")
    assert f"{(places <= 4.5).all(axis=1).sum()} points" in page.read_text()
    run(tmp_path / "m.ply", "--points", tmp_path / "c.ply", *box, "-o", page, "--no-open")
    assert "4.5  4.5" in page.read_text()
