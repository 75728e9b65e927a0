"""Lenses are those of the formats' documentation: pixels by each program's formula."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from camera_files import bundle, images_binary, images_text, metashape, ring, transforms

from hpcapp.geometry.points import FloatArray
from hpcapp.io.cameras.formats import read_cameras
from hpcapp.io.cameras.lens import Lens
from hpcapp.io.cameras.poses import Camera

PLACES, TARGET = ring(3), np.array([0.3, -0.2, 0.5])
WIDTH, HEIGHT = 4000, 3000
SEEN = np.random.default_rng(2).uniform(-0.4, 0.4, (50, 2))
K1, K2, K3, P1, P2 = -0.11, 0.04, -0.008, 0.0012, -0.0007


def pinhole(fx: float, fy: float, cx: float, cy: float) -> FloatArray:
    return SEEN * (fx, fy) + (cx, cy)


def brown(fx: float, fy: float, cx: float, cy: float, *k: float) -> FloatArray:
    """https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html, with k1 k2 p1 p2 k3 k4 k5 k6."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*k, *[0.0] * (8 - len(k)))
    x, y = SEEN.T
    r = x * x + y * y
    bend = (1 + k1 * r + k2 * r**2 + k3 * r**3) / (1 + k4 * r + k5 * r**2 + k6 * r**3)
    u = x * bend + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    v = y * bend + p1 * (r + 2 * y * y) + 2 * p2 * x * y
    return np.stack([fx * u + cx, fy * v + cy], axis=1)


def fisheye(fx: float, fy: float, cx: float, cy: float, *k: float) -> FloatArray:
    """The model of cv::fisheye."""
    r = np.linalg.norm(SEEN, axis=1)
    angle = np.arctan(r)
    bent = angle * (1 + sum(one * angle ** (2 * n) for n, one in enumerate(k, start=1)))
    return np.asarray(SEEN * (bent / r)[:, None] * (fx, fy) + (cx, cy))


def read_one(path: Path) -> Camera:
    cameras = read_cameras(path)
    assert cameras is not None
    assert len({camera.lens for camera in cameras}) == 1
    return cameras[0]


def project(camera: Camera) -> FloatArray:
    assert camera.lens is not None
    return camera.lens.fit(WIDTH, HEIGHT).project(SEEN)


COLMAP: dict[str, tuple[tuple[float, ...], FloatArray]] = {
    "SIMPLE_PINHOLE": ((3000, 2010, 1490), pinhole(3000, 3000, 2010, 1490)),
    "PINHOLE": ((3000, 2990, 2010, 1490), pinhole(3000, 2990, 2010, 1490)),
    "SIMPLE_RADIAL": ((3000, 2010, 1490, K1), brown(3000, 3000, 2010, 1490, K1)),
    "RADIAL": ((3000, 2010, 1490, K1, K2), brown(3000, 3000, 2010, 1490, K1, K2)),
    "OPENCV": (
        (3000, 2990, 2010, 1490, K1, K2, P1, P2), brown(3000, 2990, 2010, 1490, K1, K2, P1, P2)
    ),
    "FULL_OPENCV": (
        (3000, 2990, 2010, 1490, K1, K2, P1, P2, K3, 0.1, 0.02, 0.003),
        brown(3000, 2990, 2010, 1490, K1, K2, P1, P2, K3, 0.1, 0.02, 0.003),
    ),
    "OPENCV_FISHEYE": (
        (1800, 1790, 2010, 1490, 0.1, 0.02, -0.01, 0.002),
        fisheye(1800, 1790, 2010, 1490, 0.1, 0.02, -0.01, 0.002),
    ),
    "SIMPLE_RADIAL_FISHEYE": ((1800, 2010, 1490, 0.1), fisheye(1800, 1800, 2010, 1490, 0.1)),
    "RADIAL_FISHEYE": ((1800, 2010, 1490, 0.1, 0.02), fisheye(1800, 1800, 2010, 1490, 0.1, 0.02)),
}  # fmt: skip
NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4,
           "OPENCV_FISHEYE": 5, "FULL_OPENCV": 6, "SIMPLE_RADIAL_FISHEYE": 8,
           "RADIAL_FISHEYE": 9}  # fmt: skip


@pytest.mark.parametrize("model", COLMAP)
@pytest.mark.parametrize("kind", ["txt", "bin"])
def test_colmap(tmp_path: Path, model: str, kind: str) -> None:
    numbers, truth = COLMAP[model]
    if kind == "txt":
        (tmp_path / "images.txt").write_bytes(images_text(PLACES, TARGET))
        words = " ".join(map(str, (1, model, WIDTH, HEIGHT, *numbers)))
        (tmp_path / "cameras.txt").write_text(f"# Camera list\n{words}\n")
    else:
        (tmp_path / "images.bin").write_bytes(images_binary(PLACES, TARGET))
        head = struct.pack("<QIiQQ", 1, 1, NUMBERS[model], WIDTH, HEIGHT)
        (tmp_path / "cameras.bin").write_bytes(head + struct.pack(f"<{len(numbers)}d", *numbers))
    camera = read_one(tmp_path / f"images.{kind}")
    assert camera.name == {"txt": "some photo 1.jpg", "bin": "0001.jpg"}[kind]
    assert project(camera) == pytest.approx(truth)


def test_colmap_without_lenses_still_says_where_cameras_were(tmp_path: Path) -> None:
    (tmp_path / "images.txt").write_bytes(images_text(PLACES, TARGET))
    (tmp_path / "cameras.txt").write_text("1 FOV 4000 3000 1 2 3 4 5\n")
    assert read_one(tmp_path / "images.txt").lens is None


def test_metashape_names_p1_and_p2_the_other_way_round(tmp_path: Path) -> None:
    told = {"f": 3000, "cx": 10, "cy": -10, "b1": 5, "b2": 2, "k1": K1, "k2": K2, "k3": K3,
            "p1": P2, "p2": P1}  # fmt: skip
    elements = "".join(f"<{name}>{value}</{name}>" for name, value in told.items())
    size = f'<resolution width="{WIDTH}" height="{HEIGHT}"/>'
    calibration = (
        f'<calibration type="frame" class="initial"><f>1</f><k4>9</k4></calibration>{size}'
    )
    whole = metashape(PLACES, TARGET).decode()
    old = "<calibration><f>3000</f></calibration>"
    assert old in whole
    new = f'{calibration}<calibration class="adjusted">{elements}</calibration>'
    (tmp_path / "cameras.xml").write_text(whole.replace(old, new))
    camera = read_one(tmp_path / "cameras.xml")
    truth = brown(3000, 3000, WIDTH / 2 + 10, HEIGHT / 2 - 10, K1, K2, P1, P2, K3)
    bent = (truth - (WIDTH / 2 + 10, HEIGHT / 2 - 10)) / 3000
    truth[:, 0] += 5 * bent[:, 0] + 2 * bent[:, 1]
    assert camera.name == "0"
    assert project(camera) == pytest.approx(truth)


def _transforms(told: dict[str, object], own: dict[str, object]) -> bytes:
    whole = json.loads(transforms(PLACES, TARGET))
    frames = [{**frame, **own} for frame in whole["frames"]]
    return json.dumps({**told, "frames": frames}).encode()


ALL = {"w": WIDTH, "h": HEIGHT, "fl_x": 3000, "fl_y": 2990, "cx": 2010, "cy": 1490}
BENT = {"k1": K1, "k2": K2, "p1": P1, "p2": P2}
NERFS: list[tuple[dict[str, object], dict[str, object], FloatArray]] = [
    ({**ALL, **BENT}, {}, brown(3000, 2990, 2010, 1490, K1, K2, P1, P2)),
    ({**ALL, "camera_model": "PINHOLE"}, {"fl_x": 2500}, pinhole(2500, 2990, 2010, 1490)),
    ({}, {**ALL, **BENT, "k3": K3}, brown(3000, 2990, 2010, 1490, K1, K2, P1, P2, K3)),
    ({"camera_angle_x": 2 * np.arctan(0.5)}, {}, pinhole(4000, 4000, 2000, 1500)),
    (
        {**ALL, "camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k2": 0.02},
        {},
        fisheye(3000, 2990, 2010, 1490, 0.1, 0.02),
    ),
]


@pytest.mark.parametrize(("told", "own", "truth"), NERFS)
def test_nerfstudio(
    tmp_path: Path, told: dict[str, object], own: dict[str, object], truth: FloatArray
) -> None:
    (tmp_path / "transforms.json").write_bytes(_transforms(told, own))
    camera = read_one(tmp_path / "transforms.json")
    assert camera.name == "images/0.png"
    assert project(camera) == pytest.approx(truth)


SHOT = {"rotation": [0.1, 0.2, 0.3], "translation": [0, 0, 9], "camera": "c"}


@pytest.mark.parametrize(
    ("camera", "truth"),
    [
        (
            {"projection_type": "perspective", "focal": 0.75, "k1": K1, "k2": K2},
            brown(3000, 3000, 2000, 1500, K1, K2),
        ),
        (
            {"projection_type": "brown", "focal_x": 0.75, "focal_y": 0.7, "c_x": 0.01, "c_y": -0.01,
             "k1": K1, "k2": K2, "k3": K3, "p1": P1, "p2": P2},
            brown(3000, 2800, 2040, 1460, K1, K2, P1, P2, K3),
        ),
        (
            {"projection_type": "fisheye", "focal": 0.5, "k1": 0.1},
            fisheye(2000, 2000, 2000, 1500, 0.1),
        ),
    ],
)  # fmt: skip
def test_opensfm(tmp_path: Path, camera: dict[str, object], truth: FloatArray) -> None:
    told = {
        "cameras": {"c": {**camera, "width": WIDTH, "height": HEIGHT}},
        "shots": {"a.jpg": SHOT},
    }
    (tmp_path / "reconstruction.json").write_text(json.dumps([told]))
    read = read_one(tmp_path / "reconstruction.json")
    assert read.name == "a.jpg"
    assert project(read) == pytest.approx(truth)


@pytest.mark.parametrize(
    ("numbers", "truth"),
    [
        ({"disto_k3": [K1, K2, K3]}, brown(3000, 3000, 2010, 1490, K1, K2, 0, 0, K3)),
        ({"disto_t2": [K1, K2, K3, P1, P2]}, brown(3000, 3000, 2010, 1490, K1, K2, P1, P2, K3)),
        ({"fisheye": [0.1, 0.02, 0.0, 0.0]}, fisheye(3000, 3000, 2010, 1490, 0.1, 0.02)),
        ({}, pinhole(3000, 3000, 2010, 1490)),
    ],
)
def test_openmvg(tmp_path: Path, numbers: dict[str, object], truth: FloatArray) -> None:
    data = {"width": WIDTH, "height": HEIGHT, "focal_length": 3000, "principal_point": [2010, 1490]}
    view = {"filename": "b.jpg", "id_view": 9, "id_intrinsic": 3, "id_pose": 7}
    pose = {"rotation": np.eye(3).tolist(), "center": [1, 2, 3]}
    told = {
        "views": [{"key": 9, "value": {"ptr_wrapper": {"id": 1, "data": view}}}],
        "intrinsics": [
            {"key": 3, "value": {"ptr_wrapper": {"id": 2, "data": {**data, **numbers}}}}
        ],
        "extrinsics": [{"key": 7, "value": pose}],
    }
    (tmp_path / "sfm_data.json").write_text(json.dumps(told))
    camera = read_one(tmp_path / "sfm_data.json")
    assert camera.name == "b.jpg"
    assert project(camera) == pytest.approx(truth)


def test_bundler_knows_names_by_the_list_beside_it(tmp_path: Path) -> None:
    (tmp_path / "bundle.out").write_bytes(bundle(PLACES, TARGET))
    assert read_one(tmp_path / "bundle.out").name == ""
    # the first camera of the file was not registered
    names = "".join(f"photos/{n}.jpg 0 1400.5\n" for n in range(len(PLACES) + 1))
    (tmp_path / "list.txt").write_text(names)
    camera = read_one(tmp_path / "bundle.out")
    assert camera.name == "photos/1.jpg"
    assert project(camera) == pytest.approx(brown(1400.5, 1400.5, 2000, 1500, -0.01, 0.002))


@pytest.mark.parametrize("broken", ['{"fl_x": "a"}', '{"w": null}', '{"camera_model": "SPHERE"}'])
def test_a_lens_that_is_not_known_leaves_the_pose(tmp_path: Path, broken: str) -> None:
    (tmp_path / "transforms.json").write_bytes(_transforms(json.loads(broken), {}))
    camera = read_one(tmp_path / "transforms.json")
    assert camera.lens is None
    assert camera.centre == pytest.approx(PLACES[0])


def test_a_camera_looks_along_the_third_row_and_right_along_the_first(tmp_path: Path) -> None:
    makers: list[tuple[str, Callable[[FloatArray, FloatArray], bytes]]] = [
        ("images.txt", images_text), ("t.json", transforms), ("b.out", bundle),
        ("c.xml", metashape),
    ]  # fmt: skip
    for name, make in makers:
        (tmp_path / name).write_bytes(make(PLACES, TARGET))
        camera = read_one(tmp_path / name)
        above = camera.rotation @ (TARGET + np.array([0.0, 0.0, 0.1]) - camera.centre)
        assert above[2] > 0.0, name
        assert above[0] == pytest.approx(0.0, abs=1e-9), name
        assert above[1] < 0.0, name  # rows count downwards


def test_a_smaller_picture_has_the_same_lens() -> None:
    lens = Lens((4000.0, 3000.0), (3000.0, 2990.0), (10.0, -10.0), (K1,))
    assert lens.fit(1000, 750).project(SEEN) * 4 == pytest.approx(lens.project(SEEN))
    with pytest.raises(ValueError, match="has 750 x 1000 pixels, and its camera 4000 x 3000"):
        lens.fit(750, 1000)


def test_nothing_is_taken_from_where_a_distortion_turns_back() -> None:
    """r + k r^3 turns back at r^2 = -1 / 3 k: what lies beyond would come into the picture."""
    lens = Lens((1000.0, 1000.0), (700.0, 700.0), radial=(-0.5,))
    assert lens.find_reach() == pytest.approx(np.sqrt(1 / 1.5), abs=0.005)
    assert Lens((1000.0, 1000.0), (5000.0, 5000.0)).find_reach() < 0.16
