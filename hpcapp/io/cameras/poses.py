"""Poses become cameras: where each was, how it was turned, and what its picture is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hpcapp.geometry.axes import turn_by
from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.io.cameras.lens import Lens
from hpccomponent.dataclass import dataclass

FORWARDS, BACKWARDS = 1.0, -1.0
"""Which end of its z axis a camera looks along: as in computer vision, or as in OpenGL."""

_INACCURATE = 0.01  # of the entries of a rotation: files have six digits, what is none is off by 1


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera, and what is known of its picture.

    Parameters
    ----------
    centre : ndarray of float64, shape (3,)
        In the coordinates of the file.
    rotation : ndarray of float64, shape (3, 3)
        Rows: to the right, down, and along the direction in which it looks.
    name : str
        Of the picture, as the file has it; empty where it has none.
    lens : Lens or None
        None where the file tells none that is known here.
    """

    centre: FloatArray
    rotation: FloatArray
    name: str = ""
    lens: Lens | None = None


def list_places(cameras: Sequence[Camera]) -> FloatArray:
    """Return the centres of cameras and the directions along which they look, shape (n, 6)."""
    places = np.empty((len(cameras), 6))
    for place, camera in zip(places, cameras, strict=True):
        place[:3], place[3:] = camera.centre, camera.rotation[2]
    return places


def world_to_camera(
    rotations: ArrayLike,
    translations: ArrayLike,
    looks: float,
    names: Sequence[str],
    lenses: Sequence[Lens | None],
) -> list[Camera]:
    """Return the cameras of poses that take the world's coordinates to a camera's.

    They are rotations R (n, 3, 3) and translations t (n, 3) in x_camera = R x_world + t, and
    `FORWARDS` or `BACKWARDS`. Raise ValueError where a matrix is no rotation.
    """
    turned = np.asarray(rotations, np.float64).reshape(-1, 3, 3)
    moved = np.asarray(translations, np.float64).reshape(-1, 3)
    check_rotations(turned)
    with np.errstate(over="ignore", invalid="ignore"):  # whoever reads them looks at the places
        centres = -np.einsum("nji,nj->ni", turned, moved)
    axes = turned * np.array([1.0, looks, looks])[:, None]
    return [Camera(*row) for row in zip(centres, axes, names, lenses, strict=True)]


def camera_to_world(
    poses: Sequence[ArrayLike],
    looks: float,
    names: Sequence[str],
    lenses: Sequence[Lens | None],
) -> list[Camera]:
    """Return the cameras of poses that take a camera's coordinates to the world's.

    They are [R c], with (0, 0, 0, 1) below it or without, and `FORWARDS` or `BACKWARDS`; R may
    scale. Raise ValueError where a matrix is no pose.
    """
    cameras = []
    for pose, name, lens in zip(poses, names, lenses, strict=True):
        matrix = np.asarray(pose, np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(matrix[:3, 2] @ matrix[:3, 2])
        is_pose = 0.0 < length < np.inf and not (matrix[3:] != (0.0, 0.0, 0.0, 1.0)).any()
        if not is_pose or not are_rotations(matrix[None, :3, :3] / length).all():
            raise ValueError(f"a matrix is no pose of a camera: {matrix.tolist()}"[:200])
        axes = matrix[:3, :3].T / length * np.array([1.0, looks, looks])[:, None]
        cameras.append(Camera(matrix[:3, 3], axes, name, lens))
    return cameras


def quaternion_matrices(quaternions: ArrayLike) -> FloatArray:
    """Return the rotations (n, 3, 3) of quaternions (w, x, y, z).

    Raise ValueError where one is not of length 1.
    """
    rows = np.asarray(quaternions, np.float64).reshape(-1, 4)
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.sqrt(np.einsum("ni,ni->n", rows, rows))
        is_unit = np.abs(lengths - 1.0) < _INACCURATE
    if not is_unit.all():
        row = int(np.argmin(is_unit))
        raise ValueError(f"camera {row + 1}: its quaternion has the length {lengths[row]:.3g}")
    return turn_by(rows / lengths[:, None])


def are_rotations(matrices: FloatArray) -> BoolArray:
    """Tell which of some matrices, of shape (n, 3, 3), are rotations."""
    with np.errstate(over="ignore", invalid="ignore"):
        excess = np.abs(np.einsum("nij,nkj->nik", matrices, matrices) - np.eye(3)).max(axis=(1, 2))
        is_rotation: BoolArray = (excess < _INACCURATE) & (np.linalg.det(matrices) > 0.0)
    return is_rotation


def check_rotations(matrices: FloatArray) -> None:
    """Refuse matrices, of shape (n, 3, 3), that are no rotations; ValueError names the first."""
    is_rotation = are_rotations(matrices)
    if not is_rotation.all():
        row = int(np.argmin(is_rotation))
        raise ValueError(f"camera {row + 1}: no rotation: {matrices[row].tolist()}"[:200])
