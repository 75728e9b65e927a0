"""``reconstruct --texture --images``: a textured mesh, and one line where it cannot be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from click.testing import CliRunner
from painted_scene import find_things, make_mesh, make_shots, paint, to_srgb, write_shots
from PIL import Image

from hpcapp.applications.surface.cli.command import reconstruct
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.io.points.mesh_samples import sample_faces
from hpccomponent.errors import HpcError


class Files(NamedTuple):
    points: Path
    images: Path
    cameras: Path


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("job")
    cameras = write_shots(folder / "images", make_shots(6, (240, 180)), "jpg")
    samples = sample_faces(make_mesh(48)[0], 8_000)
    write_points(folder / "scan.ply", PointCloud(samples.positions, samples.normals))
    return Files(folder / "scan.ply", folder / "images", cameras)


def run(files: Files, output: Path, *words: str) -> dict[str, Any]:
    arguments = [str(files.points), "-o", str(output), "--backend", "serial", "--json",
                 "--faces", "1000", "--grid", "48", *words]  # fmt: skip
    done = CliRunner().invoke(reconstruct, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    return dict(json.loads(done.stdout))


def photographed(files: Files, images: Path | None = None) -> list[str]:
    images = images or files.images
    return ["--texture", "256", "--images", str(images), "--viewpoint", str(files.cameras)]


def test_points_without_colours_get_those_of_photographs(
    files: Files, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    report = run(files, tmp_path / "scene.obj", *photographed(files))
    assert report["texture"]["photographs"] == 6
    assert 0.8 < report["texture"]["seen"] < 1.0
    assert "of it is seen in 6 photographs; the rest takes the nearest colours" in caplog.text
    assert str(files.images) in report["command"]
    lines = [line.split() for line in (tmp_path / "scene.obj").read_text().splitlines()]
    vertices = np.array([line[1:4] for line in lines if line[:1] == ["v"]], float)
    places = np.array([line[1:3] for line in lines if line[:1] == ["vt"]], float)
    faces = np.array([[word.split("/")[:2] for word in line[1:]] for line in lines
                      if line[:1] == ["f"]], int) - 1  # fmt: skip
    picture = np.asarray(Image.open(tmp_path / "scene_colours.png"), float)
    at = places[faces[..., 1]].mean(axis=1) * (1.0, -1.0) + (0.0, 1.0)
    columns, rows = (at * len(picture)).astype(int).T
    on, things = find_things(vertices[faces[..., 0]].mean(axis=1))
    off = np.abs(picture[rows, columns] - to_srgb(paint(on, things))).max(axis=1)
    assert np.median(off) < 6.0  # exposures alone are 25


def test_the_rest_takes_the_colours_of_the_points(
    files: Files, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    samples = sample_faces(make_mesh(48)[0], 8_000)
    pink = np.tile(np.array([255, 0, 255], np.uint8), (8_000, 1))
    write_points(tmp_path / "pink.ply", PointCloud(samples.positions, samples.normals, pink))
    run(files._replace(points=tmp_path / "pink.ply"), tmp_path / "a.obj", *photographed(files))
    assert "the rest takes the colours of the points" in caplog.text
    picture = np.asarray(Image.open(tmp_path / "a_colours.png"), int)
    is_pink = (np.abs(picture - (255, 0, 255)) < 3).all(axis=2).mean()
    assert 0.005 < is_pink < 0.2


def test_missing_photographs_are_counted(
    files: Files, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    some = tmp_path / "deep" / "folder"
    some.mkdir(parents=True)
    for number in (0, 2, 4, 5):
        (some / f"{number:03}.JPG").symlink_to(files.images / f"{number:03}.jpg")
    report = run(files, tmp_path / "a.glb", *photographed(files, tmp_path / "deep"))
    assert report["texture"]["photographs"] == 4
    assert "2 of 6 photographs are not in it, such as images/001.jpg" in caplog.text


def refuse(files: Files, tmp_path: Path, *words: str) -> str:
    (tmp_path / "out").mkdir()
    with pytest.raises(HpcError) as refused:
        run(files, tmp_path / "out" / "a.glb", *words)
    assert not list((tmp_path / "out").iterdir())
    said = str(refused.value)
    assert "\n" not in said
    assert said.isprintable()
    return said


def test_what_gives_no_colours_is_refused_at_once(files: Files, tmp_path: Path) -> None:
    words = photographed(files)
    cases = {
        "--images means nothing without --texture": words[2:],
        "is no folder": [*words[:3], str(files.points), *words[4:]],
        "no file says which cameras": [*words[:4], "--viewpoint", "1,2,3"],
        "has none of 6 photographs that": [*words[:3], str(tmp_path), *words[4:]],
    }
    for number, (said, given) in enumerate(cases.items()):
        place = tmp_path / str(number)
        place.mkdir()
        assert said in refuse(files, place, *given)


def test_a_photograph_of_another_size_is_refused(files: Files, tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    Image.new("RGB", (180, 240)).save(images / "003.jpg")
    said = refuse(files, tmp_path, *photographed(files, images))
    assert "003.jpg: has 180 x 240 pixels, and its camera 240 x 180" in said
    Image.new("RGB", (120, 90)).save(images / "003.jpg")  # half as large
    assert run(files, tmp_path / "b.glb", *photographed(files, images))["texture"]["seen"] > 0.1
    (images / "003.jpg").write_text("none")
    (tmp_path / "more").mkdir()
    assert "003.jpg: cannot be read" in refuse(
        files, tmp_path / "more", *photographed(files, images)
    )


def test_cameras_without_lenses_are_refused(files: Files, tmp_path: Path) -> None:
    told = json.loads(files.cameras.read_text())
    (tmp_path / "t.json").write_text(json.dumps({"frames": told["frames"]}))
    words = photographed(files._replace(cameras=tmp_path / "t.json"))
    assert "no lens that is known here, as of images/000.jpg" in refuse(files, tmp_path, *words)
