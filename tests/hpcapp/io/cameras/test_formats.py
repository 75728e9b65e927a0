"""Camera files are told by what they hold; all formats say the same of the same cameras."""

from __future__ import annotations

import json
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from camera_files import (
    FORMATS,
    images_text,
    metashape,
    ring,
    transforms,
    write_cameras,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hpcapp.geometry.paths import MOST_PLACES
from hpcapp.io.cameras.formats import FORMATS as READ
from hpcapp.io.cameras.formats import find_camera_file, read_places
from hpccomponent.errors import InputError

PLACES, TARGET = ring(), np.array([0.3, -0.2, 0.5])
WHOLE = {name: make(PLACES, TARGET) for name, make in FORMATS.items()}


def swap(name: str, old: bytes, new: bytes) -> bytes:
    """Return the file of a format with a word changed, the first one of its kind."""
    assert old in WHOLE[name]
    return WHOLE[name].replace(old, new, 1)


def test_each_format_has_a_file_here() -> None:
    assert {word for f in READ for word in FORMATS if f"{word})" in f.name} == set(FORMATS) - {
        "components.xml"
    }


@pytest.mark.parametrize("name", FORMATS)
def test_all_formats_give_the_same_cameras_under_any_name(tmp_path: Path, name: str) -> None:
    write_cameras(tmp_path, name, PLACES, TARGET).rename(tmp_path / "something")
    cameras = read_places(tmp_path / "something")
    assert cameras is not None
    assert np.allclose(cameras[:, :3], PLACES, atol=1e-9)
    arms = TARGET - PLACES
    assert np.allclose(cameras[:, 3:], arms / np.linalg.norm(arms, axis=1, keepdims=True))


@pytest.mark.parametrize("name", ["transforms.json", "reconstruction.json", "images.txt"])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_texts_may_be_in_other_encodings(tmp_path: Path, name: str, encoding: str) -> None:
    path = tmp_path / name
    path.write_bytes(WHOLE[name].decode().encode(encoding))
    cameras = read_places(path)
    assert cameras is not None
    assert np.allclose(cameras[:, :3], PLACES, atol=1e-9)


def test_a_folder_of_colmap_is_one_of_its_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"neither images\.bin nor images\.txt"):
        find_camera_file(tmp_path)
    text = write_cameras(tmp_path, "images.txt", PLACES, TARGET)
    assert find_camera_file(tmp_path) == text
    binary = write_cameras(tmp_path, "images.bin", PLACES, TARGET)
    assert find_camera_file(tmp_path) == binary
    assert find_camera_file(text) == text


@pytest.mark.parametrize("points", ["", "1.5 2.5 -1 3 4 17", "1.5 2.5 -1 " * 100_000])
def test_images_have_a_line_of_points_of_any_length(tmp_path: Path, points: str) -> None:
    path = tmp_path / "images.txt"
    path.write_bytes(images_text(PLACES, TARGET, points))
    cameras = read_places(path)
    assert cameras is not None
    assert len(cameras) == len(PLACES)


@pytest.mark.parametrize(
    "whole",
    [
        b"\n".join(WHOLE["images.txt"].split(b"\n")[4:]),  # without their title
        json.dumps(json.loads(WHOLE["reconstruction.json"])[1]).encode(),  # without a list
    ],
)
def test_what_stands_around_cameras_may_be_missing(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "cameras"
    path.write_bytes(whole)
    cameras = read_places(path)
    assert cameras is not None
    assert np.allclose(cameras[:, :3], PLACES, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "camera"),
    [
        # not turned
        ('[{"shots": {"a": {"rotation": [0, 0, 0], "translation": [0, 0, 9]}}}]',
         [0.0, 0.0, -9.0, 0.0, 0.0, 1.0]),
        # of nerfstudio, of three rows, and scaled
        ('{"frames": [{"transform_matrix": [[2, 0, 0, 5], [0, 2, 0, 6], [0, 0, 2, 7]]}]}',
         [5.0, 6.0, 7.0, 0.0, 0.0, -1.0]),
    ],
)  # fmt: skip
def test_one_camera_is_read(tmp_path: Path, text: str, camera: list[float]) -> None:
    path = tmp_path / "one.json"
    path.write_text(text)
    assert read_places(path) == pytest.approx(np.array([camera]))


def test_a_chunk_without_a_transform_is_in_the_coordinates_of_the_world(tmp_path: Path) -> None:
    path = tmp_path / "cameras.xml"
    text = metashape(PLACES, TARGET)
    first, last = text.rindex(b"<transform>"), text.rindex(b"</transform>")
    path.write_bytes(text[:first] + text[last + len(b"</transform>") :])
    cameras = read_places(path)
    assert cameras is not None
    apart = np.linalg.norm(cameras[1:, :3] - cameras[:-1, :3], axis=1)
    assert apart * 7.5 == pytest.approx(np.linalg.norm(PLACES[1:] - PLACES[:-1], axis=1))


@pytest.mark.parametrize(("length", "is_read"), [(0.987, False), (0.993, True), (1.013, False)])
def test_quaternions_of_few_digits_are_scaled(tmp_path: Path, length: float, is_read: bool) -> None:
    path = tmp_path / "images.txt"
    path.write_text(f"1 {0.6 * length} 0 {0.8 * length} 0 0 0 5 1 a.jpg\n\n")
    if not is_read:
        with pytest.raises(InputError, match="quaternion"):
            read_places(path)
    else:
        assert read_places(path) == pytest.approx(np.array([[4.8, 0, 1.4, -0.96, 0, -0.28]]))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1 2 3\n4 5 6\n",
        "x,y,z\n1,2,3\n",
        "# timestamp tx ty tz qx qy qz qw\n0.5 1 2 3 0 0 0 1\n",
        "1 2 3 4 5 6 7 8 9\n",
        "1 1 0 0 0 6 7 8 9 10 11\n",
        "hello\n",
    ],
)
def test_other_texts_are_left_to_whoever_reads_trajectories(tmp_path: Path, text: str) -> None:
    path = tmp_path / "path.txt"
    path.write_text(text)
    assert read_places(path) is None


def test_of_many_cameras_some_are_taken_that_are_far_apart(tmp_path: Path) -> None:
    across = np.linspace(-50.0, 50.0, 40)
    places = np.stack(np.meshgrid(across, across, [30.0]), axis=-1).reshape(-1, 3)
    cameras = read_places(write_cameras(tmp_path, "images.bin", places, places * (1, 1, 0)))
    assert cameras is not None
    assert len(cameras) == MOST_PLACES
    gaps = np.linalg.norm(cameras[:, None, :3] - cameras[None, :, :3], axis=2) + 100 * np.eye(64)
    assert gaps.min() > 9.0  # on a grid of 8 by 8 they are 12.5 apart
    nearest = np.linalg.norm(places[:, None] - cameras[None, :, :3], axis=2).min(axis=1)
    assert nearest.max() < 14.0


HUGE = struct.pack("<Q", 10**12)
ZERO_TURN = WHOLE["images.bin"][:12] + struct.pack("<4d", 0, 0, 0, 0) + WHOLE["images.bin"][44:]
OTHERS = {
    "json: other": (b'{"type": "FeatureCollection", "features": []}', "is JSON, but none of nerf"),
    "json: list": (b"[[1, 2, 3], [4, 5, 6]]", "is JSON, but none of"),
    "json: indented": (b'[\n  {"x": 1}\n]', "is JSON, but none of"),
    "json: cut": (WHOLE["transforms.json"][:-20], "begins as JSON does, but"),
    "json: deep": (b"[" * 100_000, "begins as JSON does, but"),
    "json: two": (b"{} {}", "begins as JSON does, but"),
    "xml: other": (b'<?xml version="1.0"?>\n<gpx></gpx>', "is XML, but none of Metashape"),
    "xml: cut": (WHOLE["cameras.xml"][:-20], "its XML: no element found"),
    "xml: entities": (
        swap("cameras.xml", b"<document", b'<!DOCTYPE d [<!ENTITY a "1">]><document'),
        "declares a document type",
    ),
    "xml: deep": (b"<document>" + b"<chunk>" * 100_000, "elements within each other"),
    "xml: word": (swap("cameras.xml", b"<scale locked=\"true\">7.5", b"<scale>seven"), "'seven'"),
    "xml: zero": (swap("cameras.xml", b"<scale locked=\"true\">7.5", b"<scale>0"), "scale"),
    "xml: few": (swap("cameras.xml", b"<transform>", b"<transform>1 "), "17 numbers, not 16"),
    "xml: long": (swap("cameras.xml", b"<transform>", b"<transform>" + b"1 " * 9999), "characters"),
    "xml: encoding": (swap("cameras.xml", b"UTF-8", b"UTF-88"), "encoding"),
    "binary: other": (b"\xff\xd8\xff\xe0\x00\x10JFIF\x00" + b"\x01" * 300, r"images\.bin.*claims"),
    "binary: huge": (HUGE + WHOLE["images.bin"][8:], "claims 1000000000000 images, and has"),
    "binary: cut": (WHOLE["images.bin"][:-30], "image 8 claims 8 points; the file is cut"),
    "binary: cut name": (WHOLE["images.bin"][:76], "claims 8 images|no name"),
    "binary: longer": (WHOLE["images.bin"] + b"\0\0", "end at byte"),
    "binary: no turn": (ZERO_TURN, "camera 1: its quaternion has the length 0"),
    "text: none": (WHOLE["images.txt"][:180], "no camera with a pose"),
    "text: points": (images_text(PLACES, TARGET, "a b c"), "line after image 1 is not"),
    "text: cut": (WHOLE["images.txt"][:-80], "no line of an image"),
    "text: no points": (
        b"\n".join(line for line in WHOLE["images.txt"].split(b"\n") if line),
        "may be empty, but not missing",
    ),
    "text: quaternion": (b"1 0.5 0.5 0.5 0.9 1 2 3 1 a.jpg\n\n", "length 1.2"),
    "text: far": (b"1 1 0 0 0 1e300 2 3 1 a.jpg\n\n", r"at no place: \[-1e\+300"),
    "colmap: cameras": (b"# Camera list with one line of\n1 PINHOLE 9 9 9\n", "is cameras.txt of"),
    "colmap: points": (b"# 3D point list with one line of\n1 2 3 4 5 6 7\n", "is points3D.txt of"),
    "bundle: version": (swap("bundle.out", b"v0.3", b"v0.4"), "of version 'v0.4', and v0.3 is"),
    "bundle: huge": (swap("bundle.out", b"9 1\n", b"1000000000000 1\n"), "claims 1000000000000"),
    "bundle: negative": (swap("bundle.out", b"9 1\n", b"-9 1\n"), "claims -9 cameras"),
    "bundle: cut": (WHOLE["bundle.out"][:900], "ends after"),
    "bundle: word": (swap("bundle.out", b"1400.5", b"focal"), "'focal'"),
    "bundle: nan": (swap("bundle.out", b"1400.5 -0.01 0.002\n", b"1 0 0\nnan "), "no rotation"),
    "bundle: mirrored": (
        b"# Bundle file v0.3\n1 0\n1 0 0\n1 0 0\n0 1 0\n0 0 -1\n0 0 0\n",
        "camera 1: no rotation",
    ),
    "frames: none": (b'{"frames": []}', "no camera with a pose"),
    "frames: type": (b'{"frames": 3}', "Expected `array`, got `int`"),
    "frames: no matrix": (b'{"frames": [{"file_path": "a"}]}', "transform_matrix"),
    "frames: shape": (b'{"frames": [{"transform_matrix": [[1, 2, 3, 4]]}]}', "length >= 3"),
    "frames: transposed": (
        b'{"frames": [{"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[5,6,7,1]]}]}',
        "no pose of a camera",
    ),
    "frames: zero": (
        b'{"frames": [{"transform_matrix": [[0,0,0,0],[0,0,0,0],[0,0,0,0]]}]}',
        "no pose of a camera",
    ),
    "frames: nan": (transforms(PLACES, np.array([np.nan, 0, 0])), "begins as JSON does, but"),
    "frames: infinite": (
        b'{"frames": [{"transform_matrix": [[1,0,0,1e999],[0,1,0,0],[0,0,1,0]]}]}',
        "Number out of range",
    ),
    "openmvg: type": (b'{"extrinsics": [{"key": 0, "value": 7}]}', r"Expected `object`, got `int`"),
    "openmvg: rotation": (
        b'{"extrinsics": [{"value": {"rotation": [[1,0,0],[0,2,0],[0,0,1]], "center": [0,0,0]}}]}',
        "camera 1: no rotation",
    ),
    "opensfm: type": (b'[{"shots": []}]', "Expected `object`, got `array`"),
    "opensfm: far": (
        b'[{"shots": {"a": {"rotation": [1e200, 0, 0], "translation": [0, 0, 9]}}}]',
        "quaternion",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "problem"), OTHERS.values(), ids=OTHERS)
def test_what_is_no_camera_file_is_refused_in_a_line(
    tmp_path: Path, content: bytes, problem: str
) -> None:
    path = tmp_path / "cameras"
    path.write_bytes(content)
    with pytest.raises(InputError, match=problem) as caught:
        read_places(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: ")
    assert "\n" not in said
    assert len(said) < 700
    assert caught.value.exit_code == 3


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_places(tmp_path / "none")


words = st.binary(max_size=8) | st.sampled_from(
    [b"nan", b"-1", b"1e999", b"[", b"}", b"\0", b'"', b"<a>", b"</transform>", b"\n", b"9" * 5000]
)
damages = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 40), words), max_size=3)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=300, deadline=None
)
@given(st.sampled_from(list(WHOLE.values())), damages, st.floats(0, 1))
def test_damaged_camera_files(
    tmp_path: Path, whole: bytes, cuts: list[tuple[float, int, bytes]], kept: float
) -> None:
    for where, removed, word in cuts:
        at = int(where * len(whole))
        whole = whole[:at] + word + whole[at + removed :]
    path = tmp_path / "damaged"
    path.write_bytes(whole[: int(kept * 2 * len(whole))])  # half of them whole
    with suppress(InputError):
        cameras = read_places(path)
        if cameras is not None:
            assert np.isfinite(cameras).all()
            assert np.allclose(np.linalg.norm(cameras[:, 3:], axis=1), 1.0, atol=0.02)
