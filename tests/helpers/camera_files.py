"""Camera files of each format, as its documentation has them, of cameras whose places are known."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hpcapp.geometry.points import FloatArray

Write = Callable[[FloatArray, FloatArray], bytes]
"""Makes the file of cameras at places, which look at the origin of each row of `targets`."""

_FLIP = np.diag([1.0, -1.0, -1.0])  # between x right, y down, z forwards, and y up, z backwards


def ring(count: int = 8, radius: float = 5.0, height: float = 2.0) -> FloatArray:
    """Return places around the z axis."""
    turn = 2.0 * np.pi * np.arange(count) / count + 0.1
    flat = np.full(count, height)
    places: FloatArray = np.stack([radius * np.cos(turn), radius * np.sin(turn), flat], axis=1)
    return places


def look_at(places: FloatArray, targets: FloatArray) -> FloatArray:
    """Return rotations from world to camera, (n, 3, 3): x right, y down, z towards the target."""
    rotations = []
    for place, target in zip(places, np.broadcast_to(targets, places.shape), strict=True):
        forwards = (target - place) / np.linalg.norm(target - place)
        up = np.array([0.0, 0.0, 1.0]) if abs(forwards[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
        right = np.cross(forwards, up)
        right /= np.linalg.norm(right)
        rotations.append(np.stack([right, np.cross(forwards, right), forwards]))
    return np.array(rotations)


def _poses(places: FloatArray, targets: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    for place, rotation in zip(places, look_at(places, targets), strict=True):
        yield rotation, -rotation @ place


def _quaternion(rotation: FloatArray) -> list[float]:
    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return [w, x, y, z]


def images_text(places: FloatArray, targets: FloatArray, points: str = "") -> bytes:
    """COLMAP's images.txt."""
    lines = [
        "# Image list with two lines of data per image:",
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "#   POINTS2D[] as (X, Y, POINT3D_ID)",
        f"# Number of images: {len(places)}, mean observations per image: 2",
    ]
    for i, (rotation, translation) in enumerate(_poses(places, targets), start=1):
        numbers = " ".join(map(repr, [*_quaternion(rotation), *translation.tolist()]))
        lines += [f"{i} {numbers} 1 some photo {i}.jpg", points]
    return "\n".join(lines).encode() + b"\n"


def images_binary(places: FloatArray, targets: FloatArray) -> bytes:
    """COLMAP's images.bin."""
    parts = [struct.pack("<Q", len(places))]
    for i, (rotation, translation) in enumerate(_poses(places, targets), start=1):
        parts += [
            struct.pack("<I7dI", i, *_quaternion(rotation), *translation, 1),
            f"{i:04}.jpg".encode() + b"\0",
            struct.pack("<Q", i),
            struct.pack("<ddq", 1.5, 2.5, -1) * i,
        ]
    return b"".join(parts)


def bundle(places: FloatArray, targets: FloatArray) -> bytes:
    """Bundler's bundle.out, with a camera that was not registered, and a point."""
    lines = ["# Bundle file v0.3", f"{len(places) + 1} 1", *["0 0 0"] * 5]
    for rotation, translation in _poses(places, targets):
        lines.append("1400.5 -0.01 0.002")
        lines += [" ".join(map(repr, row)) for row in (_FLIP @ rotation).tolist()]
        lines.append(" ".join(map(repr, (_FLIP @ translation).tolist())))
    lines += ["0.1 0.2 0.3", "255 128 0", "2 0 12 3.5 -4.5 1 13 5.5 6.5"]
    return "\n".join(lines).encode() + b"\n"


def transforms(places: FloatArray, targets: FloatArray) -> bytes:
    """The transforms.json of nerfstudio and instant-ngp, in one line."""
    frames = []
    for rotation, translation in _poses(places, targets):
        pose = np.eye(4)
        pose[:3, :3] = rotation.T @ _FLIP
        pose[:3, 3] = -rotation.T @ translation
        frames.append({"file_path": "images/0.png", "transform_matrix": pose.tolist()})
    return json.dumps(
        {"camera_model": "OPENCV", "fl_x": 1072.0, "w": 3008, "frames": frames}
    ).encode()


def openmvg(places: FloatArray, targets: FloatArray) -> bytes:
    """OpenMVG's sfm_data.json."""
    poses = [
        {"rotation": rotation.tolist(), "center": (-rotation.T @ translation).tolist()}
        for rotation, translation in _poses(places, targets)
    ]
    told = {
        "sfm_data_version": "0.3",
        "root_path": "images",
        "views": [{"key": 0, "value": {"ptr_wrapper": {"id": 1, "data": {"id_pose": 0}}}}],
        "extrinsics": [{"key": i, "value": pose} for i, pose in enumerate(poses)],
        "structure": [{"key": 0, "value": {"X": [0.1, 0.2, 0.3], "observations": []}}],
    }
    return json.dumps(told, indent=4).encode()


def opensfm(places: FloatArray, targets: FloatArray) -> bytes:
    """OpenSfM's reconstruction.json: two parts, of which the second has most of the photographs."""
    shots = {
        f"{i}.jpg": {
            "rotation": Rotation.from_matrix(rotation).as_rotvec().tolist(),
            "translation": translation.tolist(),
            "camera": "v2 dji fc6310r",
            "gps_position": [0.0, 0.0, 0.0],
        }
        for i, (rotation, translation) in enumerate(_poses(places, targets))
    }
    few = {"a.jpg": {"rotation": [0.0, 0.0, 0.0], "translation": [0.0, 0.0, 9.0], "camera": "x"}}
    common = {
        "cameras": {"v2 dji fc6310r": {"projection_type": "brown", "focal_x": 0.6}},
        "points": {"1": {"color": [1.0, 2.0, 3.0], "coordinates": [0.1, 0.2, 0.3]}},
        "reference_lla": {"latitude": 47.1, "longitude": 8.5, "altitude": 0.0},
    }
    return json.dumps([common | {"shots": few}, common | {"shots": shots}]).encode()


def metashape(places: FloatArray, targets: FloatArray, *, has_components: bool = False) -> bytes:
    """Metashape's XML: cameras within a chunk that is turned, scaled and moved."""
    turn, scale, offset = (
        Rotation.from_euler("xyz", [20, 30, 40], degrees=True),
        7.5,
        (3.0, 4.0, 5.0),
    )
    cameras = []
    for i, (rotation, translation) in enumerate(_poses(places, targets)):
        pose = np.eye(4)
        pose[:3, :3] = turn.as_matrix().T @ rotation.T
        pose[:3, 3] = turn.as_matrix().T @ (-rotation.T @ translation - offset) / scale
        component = ' component_id="4"' if has_components else ""
        cameras.append(
            f'<camera id="{i}" sensor_id="0"{component} label="{i}"><transform>'
            f"{' '.join(map(repr, pose.ravel().tolist()))}</transform>"
            "<rotation_covariance>1 0 0 0 1 0 0 0 1</rotation_covariance>"
            "<orientation>1</orientation></camera>"
        )
    transform = (
        '<transform><rotation locked="true">'
        f"{' '.join(map(repr, turn.as_matrix().ravel().tolist()))}</rotation>"
        f'<translation locked="true">{" ".join(map(repr, offset))}</translation>'
        f'<scale locked="true">{scale}</scale></transform>'
    )
    components = f'<components><component id="4">{transform}</component></components>'
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="Chunk 1">'
        '<sensors><sensor id="0" type="frame"><calibration><f>3000</f></calibration></sensor>'
        "</sensors>"
        f"{components if has_components else ''}"
        f'<cameras><group id="0">{cameras[0]}</group>{"".join(cameras[1:])}'
        '<camera id="99" sensor_id="0" label="not aligned"/></cameras>'
        f"{'' if has_components else transform}<region><R>1 0 0 0 1 0 0 0 1</R></region>"
        "</chunk></document>\n"
    ).encode()


def metashape_components(places: FloatArray, targets: FloatArray) -> bytes:
    """The same as later versions write it."""
    return metashape(places, targets, has_components=True)


FORMATS: dict[str, Write] = {
    "images.txt": images_text,
    "images.bin": images_binary,
    "bundle.out": bundle,
    "transforms.json": transforms,
    "sfm_data.json": openmvg,
    "reconstruction.json": opensfm,
    "cameras.xml": metashape,
    "components.xml": metashape_components,
}
"""By their usual names."""


def write_cameras(folder: Path, name: str, places: FloatArray, targets: FloatArray) -> Path:
    """Write the file of cameras that look at targets, which may be one."""
    path = folder / name
    path.write_bytes(FORMATS[name](places, targets))
    return path
