"""Poses become places: where each camera was, and along which direction it looked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hpcapp.geometry.axes import turn_by
from hpcapp.geometry.points import BoolArray, FloatArray

FORWARDS, BACKWARDS = 1.0, -1.0
"""Which end of its z axis a camera looks along: as in computer vision, or as in OpenGL."""

_INACCURATE = 0.01  # of the entries of a rotation: files have six digits, what is none is off by 1


def world_to_camera(rotations: ArrayLike, translations: ArrayLike, looks: float) -> FloatArray:
    """Return the cameras of poses that take the world's coordinates to a camera's, (n, 6).

    They are the centre -R^T t and the direction for rotations R (n, 3, 3) and translations t (n, 3)
    in x_camera = R x_world + t, and `FORWARDS` or `BACKWARDS`. Raise ValueError where a matrix is
    no rotation.
    """
    turned = np.asarray(rotations, np.float64).reshape(-1, 3, 3)
    moved = np.asarray(translations, np.float64).reshape(-1, 3)
    check_rotations(turned)
    with np.errstate(over="ignore", invalid="ignore"):  # whoever reads them looks at the places
        centres = -np.einsum("nji,nj->ni", turned, moved)
    return np.concatenate([centres, looks * turned[:, 2]], axis=1)


def camera_to_world(poses: Sequence[ArrayLike], looks: float) -> FloatArray:
    """Return the cameras of poses that take a camera's coordinates to the world's, (n, 6).

    They are the centre c and the direction for [R c], with (0, 0, 0, 1) below it or without, and
    `FORWARDS` or `BACKWARDS`; R may scale. Raise ValueError where a matrix is no pose.
    """
    cameras = np.empty((len(poses), 6))
    for camera, pose in zip(cameras, poses, strict=True):
        matrix = np.asarray(pose, np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(matrix[:3, 2] @ matrix[:3, 2])
        if not 0.0 < length < np.inf or (matrix[3:] != (0.0, 0.0, 0.0, 1.0)).any():
            raise ValueError(f"a matrix is no pose of a camera: {matrix.tolist()}"[:200])
        camera[:3], camera[3:] = matrix[:3, 3], looks * matrix[:3, 2] / length
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
