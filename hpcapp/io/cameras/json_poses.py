"""Camera files in JSON: of nerfstudio and instant-ngp, of OpenMVG, of OpenSfM and OpenDroneMap.

Of each, what the types here name is read; points and matches, most of the file, are passed over.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import msgspec
import numpy as np

from hpcapp.io.cameras.json_lenses import (
    PinholeFields,
    make_pinhole,
    read_common,
    read_openmvg_lenses,
    read_opensfm_lens,
)
from hpcapp.io.cameras.poses import (
    BACKWARDS,
    FORWARDS,
    Camera,
    camera_to_world,
    check_rotations,
    quaternion_matrices,
    world_to_camera,
)
from hpccomponent.foreign_json import decode_large

JsonObject = Mapping[str, msgspec.Raw]
"""The keys of an object, and what is below each, as it is in the file."""

_Vector = tuple[float, float, float]
_Row = tuple[float, float, float, float]


class _Frame(PinholeFields, kw_only=True):
    transform_matrix: Annotated[list[_Row], msgspec.Meta(min_length=3, max_length=4)]
    file_path: str = ""


class _Pose(msgspec.Struct):
    rotation: tuple[_Vector, _Vector, _Vector]
    center: _Vector


class _Extrinsic(msgspec.Struct):
    value: _Pose
    key: int = -1


class _ViewData(msgspec.Struct):
    filename: str = ""
    id_intrinsic: int = -1
    id_pose: int = -1


class _ViewPointer(msgspec.Struct):
    data: _ViewData = msgspec.field(default_factory=_ViewData)


class _ViewValue(msgspec.Struct):
    ptr_wrapper: _ViewPointer = msgspec.field(default_factory=_ViewPointer)


class _View(msgspec.Struct):
    value: _ViewValue = msgspec.field(default_factory=_ViewValue)


class _Shot(msgspec.Struct):
    rotation: _Vector
    translation: _Vector
    camera: str = ""


def split_json(content: bytes) -> list[JsonObject]:
    """Return the object that a file holds, or those in its list; ValueError where it is no JSON."""
    parts: list[bytes] = [content]
    if content.lstrip().startswith(b"["):
        raw = decode_large(content, list[msgspec.Raw])
        parts = [part for part in raw if bytes(memoryview(part)[:1]) == b"{"]
    return [decode_large(part, dict[str, msgspec.Raw]) for part in parts]


def read_frames(objects: Sequence[JsonObject]) -> list[Camera]:
    """Read a transforms.json: poses from camera to world, with the axes of OpenGL.

    https://docs.nerf.studio/quickstart/data_conventions.html
    """
    whole = next(one for one in objects if "frames" in one)
    frames = decode_large(whole["frames"], list[_Frame])
    common = read_common(whole)
    lenses = [make_pinhole(common, frame) for frame in frames]
    matrices = [frame.transform_matrix for frame in frames]
    return camera_to_world(matrices, BACKWARDS, [frame.file_path for frame in frames], lenses)


def read_openmvg(objects: Sequence[JsonObject]) -> list[Camera]:
    """Read an sfm_data.json: rotations from world to camera, and centres."""
    extrinsics = decode_large(_find(objects, "extrinsics"), list[_Extrinsic])
    poses = [extrinsic.value for extrinsic in extrinsics]
    views = [view for one in objects if "views" in one
             for view in decode_large(one["views"], list[_View])]  # fmt: skip
    pictures = {view.value.ptr_wrapper.data.id_pose: view.value.ptr_wrapper.data for view in views}
    lenses = {key: lens for one in objects if "intrinsics" in one
              for key, lens in read_openmvg_lenses(one["intrinsics"]).items()}  # fmt: skip
    shown = [pictures.get(extrinsic.key, _ViewData()) for extrinsic in extrinsics]
    rotations = np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)
    centres = np.array([pose.center for pose in poses]).reshape(-1, 3)
    check_rotations(rotations)
    return [
        Camera(centre, rotation, picture.filename, lenses.get(picture.id_intrinsic))
        for centre, rotation, picture in zip(centres, rotations, shown, strict=True)
    ]


def read_opensfm(objects: Sequence[JsonObject]) -> list[Camera]:
    """Read a reconstruction.json: axis times angle, and translation, from world to camera.

    Of several reconstructions, each in coordinates of its own, the one of most photographs counts.
    """
    parts = [
        (decode_large(one["shots"], dict[str, _Shot]), one) for one in objects if "shots" in one
    ]
    shots, whole = max(parts, key=lambda part: len(part[0]))
    cameras = decode_large(whole["cameras"], dict[str, msgspec.Raw]) if "cameras" in whole else {}
    lenses = {name: read_opensfm_lens(camera) for name, camera in cameras.items()}
    turns = np.array([shot.rotation for shot in shots.values()]).reshape(-1, 3)
    with np.errstate(over="ignore", invalid="ignore"):  # then the quaternion has no length 1
        angles = np.sqrt(np.einsum("ni,ni->n", turns, turns))[:, None]
        axes = turns / np.where(angles > 0.0, angles, 1.0)
        quaternions = np.concatenate([np.cos(angles / 2), np.sin(angles / 2) * axes], axis=1)
    return world_to_camera(
        quaternion_matrices(quaternions),
        [shot.translation for shot in shots.values()],
        FORWARDS,
        list(shots),
        [lenses.get(shot.camera) for shot in shots.values()],
    )


def _find(objects: Sequence[JsonObject], key: str) -> msgspec.Raw:
    return next(one[key] for one in objects if key in one)
