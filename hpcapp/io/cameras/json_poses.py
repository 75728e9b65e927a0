"""Camera files in JSON: of nerfstudio and instant-ngp, of OpenMVG, of OpenSfM and OpenDroneMap.

Of each, what the types here name is read; points and matches, most of the file, are passed over.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import msgspec
import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.cameras.poses import (
    BACKWARDS,
    FORWARDS,
    camera_to_world,
    quaternion_matrices,
    world_to_camera,
)
from hpccomponent.foreign_json import decode_large

JsonObject = Mapping[str, msgspec.Raw]
"""The keys of an object, and what is below each, as it is in the file."""

_Vector = tuple[float, float, float]
_Row = tuple[float, float, float, float]


class _Frame(msgspec.Struct):
    transform_matrix: Annotated[list[_Row], msgspec.Meta(min_length=3, max_length=4)]


class _Pose(msgspec.Struct):
    rotation: tuple[_Vector, _Vector, _Vector]
    center: _Vector


class _Extrinsic(msgspec.Struct):
    value: _Pose


class _Shot(msgspec.Struct):
    rotation: _Vector
    translation: _Vector


def split_json(content: bytes) -> list[JsonObject]:
    """Return the object that a file holds, or those in its list; ValueError where it is no JSON."""
    parts: list[bytes] = [content]
    if content.lstrip().startswith(b"["):
        raw = decode_large(content, list[msgspec.Raw])
        parts = [part for part in raw if bytes(memoryview(part)[:1]) == b"{"]
    return [decode_large(part, dict[str, msgspec.Raw]) for part in parts]


def read_frames(objects: Sequence[JsonObject]) -> FloatArray:
    """Read a transforms.json: poses from camera to world, with the axes of OpenGL.

    https://docs.nerf.studio/quickstart/data_conventions.html
    """
    frames = decode_large(_find(objects, "frames"), list[_Frame])
    return camera_to_world([frame.transform_matrix for frame in frames], BACKWARDS)


def read_openmvg(objects: Sequence[JsonObject]) -> FloatArray:
    """Read an sfm_data.json: rotations from world to camera, and centres."""
    extrinsics = decode_large(_find(objects, "extrinsics"), list[_Extrinsic])
    poses = [extrinsic.value for extrinsic in extrinsics]
    rotations = [pose.rotation for pose in poses]
    cameras = world_to_camera(rotations, np.zeros((len(poses), 3)), FORWARDS)
    cameras[:, :3] = np.array([pose.center for pose in poses]).reshape(-1, 3)
    return cameras


def read_opensfm(objects: Sequence[JsonObject]) -> FloatArray:
    """Read a reconstruction.json: axis times angle, and translation, from world to camera.

    Of several reconstructions, each in coordinates of its own, the one of most photographs counts.
    """
    parts = [decode_large(part["shots"], dict[str, _Shot]) for part in objects if "shots" in part]
    shots = max(parts, key=len).values()
    turns = np.array([shot.rotation for shot in shots]).reshape(-1, 3)
    with np.errstate(over="ignore", invalid="ignore"):  # then the quaternion has no length 1
        angles = np.sqrt(np.einsum("ni,ni->n", turns, turns))[:, None]
        axes = turns / np.where(angles > 0.0, angles, 1.0)
        quaternions = np.concatenate([np.cos(angles / 2), np.sin(angles / 2) * axes], axis=1)
    translations = [shot.translation for shot in shots]
    return world_to_camera(quaternion_matrices(quaternions), translations, FORWARDS)


def _find(objects: Sequence[JsonObject], key: str) -> msgspec.Raw:
    return next(one[key] for one in objects if key in one)
