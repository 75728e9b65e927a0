"""``--viewpoint`` takes a direction, places, and files of trajectories and of cameras."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from camera_files import ring, write_cameras

import hpcapp
from hpcapp.applications.surface.normals.sensor import sensor_of
from hpcapp.applications.surface.normals.viewpoint import Viewpoint, parse_viewpoint, type_viewpoint
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import InputError, UsageError

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("words", "viewpoint"),
    [
        ([], ()),
        (["above"], "above"),
        (["inside", "inside"], "inside"),
        (["1,-2,3e5"], ((1.0, -2.0, 3e5),)),
        (["1,2,3", "4,5,6"], ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))),
        (["1,2,3@1e9"], ((1.0, 2.0, 3.0, 1e9),)),
        (["1,2,3,0,0.6,-0.8"], ((1.0, 2.0, 3.0, 0.0, 0.6, -0.8),)),
    ],
)
def test_words_are_parsed_and_typed_again(words: list[str], viewpoint: Viewpoint) -> None:
    assert parse_viewpoint(words) == viewpoint
    assert parse_viewpoint(type_viewpoint(viewpoint)[1::2]) == viewpoint


def test_places_and_trajectories_stand_together(tmp_path: Path) -> None:
    path = tmp_path / "path.txt"
    path.write_text("1 2 3\n")
    assert parse_viewpoint(["0,0,9", str(path)]) == ((0.0, 0.0, 9.0), (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    "words",
    [
        ["1,2"],
        ["1,2,3,4"],
        ["1,2@3"],
        ["1@2,3,4"],
        ["1,2,3@4@5"],
        ["1,2,3@nan"],
        ["1,2,3@"],
        ["1,2,nan"],
        ["1,2,3,0,0,nan"],
        ["1e300,0,0"],
        ["1,9999999999999999999,2"],
        ["up"],
        ["no.csv"],
        [""],
    ],
)
def test_other_words_are_refused(words: list[str]) -> None:
    with pytest.raises(UsageError, match=r"neither above, below, inside, outside, nor"):
        parse_viewpoint(words)


def test_a_direction_stands_alone() -> None:
    with pytest.raises(UsageError, match="viewpoints='above' stands beside"):
        parse_viewpoint(["1,2,3", "above"])


def test_what_the_user_says_is_told() -> None:
    assert sensor_of("below").kind == "below"
    assert sensor_of("below").is_told
    places = sensor_of(((1.0, 2.0, 3.0),)).places
    assert places is not None
    assert places.tolist() == [[1.0, 2.0, 3.0]]
    assert not sensor_of(()).is_told


def test_cameras_have_a_direction_and_places_have_none() -> None:
    sensor = sensor_of(((1.0, 2.0, 3.0), (4.0, 5.0, 6.0, 0.0, 0.0, -1.0)))
    assert sensor.places is not None
    assert sensor.axes is not None
    assert sensor.places.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert sensor.axes.tolist() == [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]


def test_a_folder_and_a_file_of_cameras_are_typed_again(tmp_path: Path) -> None:
    path = write_cameras(tmp_path, "images.bin", ring(), np.zeros(3))
    cameras = parse_viewpoint([str(path)])
    assert parse_viewpoint([str(tmp_path)]) == cameras
    assert parse_viewpoint(type_viewpoint(cameras)[1::2]) == cameras
    assert len(parse_viewpoint([str(path), "1,2,3"])) == len(ring()) + 1
    with pytest.raises(InputError, match="is XML, but none of Metashape"):
        parse_viewpoint([str(write_other(tmp_path))])


def write_other(folder: Path) -> Path:
    path = folder / "images.txt"
    path.write_text("<kml><Placemark/></kml>")
    return path


@pytest.fixture(scope="module")
def relief() -> FloatArray:
    """A wall in the plane of x and z, rough alike on both sides: nothing in it tells its front."""
    x, z = np.random.default_rng(3).uniform(-2.0, 2.0, (2, 6_000))
    points: FloatArray = np.stack([x, 0.1 * np.sin(4 * x) * np.sin(4 * z), z], axis=1)
    return points


@pytest.mark.parametrize("name", ["images.txt", "cameras.xml"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_wall_faces_whoever_took_photographs_of_it(
    relief: FloatArray, tmp_path: Path, name: str, side: float
) -> None:
    x, z, y = ring(radius=1.5, height=6.0).T
    places = np.stack([x, side * y, z], axis=1)
    path = write_cameras(tmp_path, name, places, np.zeros(3))
    mesh = hpcapp.reconstruct(relief, viewpoints=str(path), close="no", grid=48)
    corners = mesh.vertices[mesh.faces]
    faces = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(faces, axis=1)
    assert areas.sum() > 16.0
    assert areas[side * faces[:, 1] > 0.0].sum() > 0.99 * areas.sum()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b'{"type": "FeatureCollection"}', "is JSON, but none of nerfstudio"),
        (b"\0\1SBET\0" * 99, "is binary, read as cameras of COLMAP (images.bin): it claims"),
    ],
)
def test_the_command_refuses_other_files_in_a_line(
    run: Run, sphere_file: Path, tmp_path: Path, content: bytes, said: str
) -> None:
    path = tmp_path / "images.txt"
    path.write_bytes(content)
    code, out, err = run("reconstruct", str(sphere_file), "-o", str(tmp_path / "mesh.ply"),
                         "--viewpoint", str(path))  # fmt: skip
    assert (code, out) == (3, "")
    assert len(err.splitlines()) == 1
    assert f"{path}: {said}" in err


def test_cameras_in_other_coordinates_end_the_job(relief: FloatArray, tmp_path: Path) -> None:
    path = write_cameras(tmp_path, "images.txt", ring(), np.zeros(3))
    with pytest.raises(InputError, match=r"the cameras \(viewpoints\) did not see these points"):
        hpcapp.reconstruct(relief + np.array([5e5, 5e6, 0.0]), viewpoints=str(path), grid=48)
