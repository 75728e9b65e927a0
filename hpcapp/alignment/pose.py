"""Rigid moves, as 4 x 4 matrices."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hpcapp.geometry.points import FloatArray


def make_pose(turn: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the matrix of a rotation, (3, 3), and what is added after it, (3,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift
    return pose


def shift_pose(shift: FloatArray) -> FloatArray:
    """Return the matrix of a shift, (3,)."""
    return make_pose(np.eye(3), shift)


def move(pose: FloatArray, positions: FloatArray) -> FloatArray:
    """Return positions, (n, 3), moved."""
    return positions @ pose[:3, :3].T + pose[:3, 3]


def invert(pose: FloatArray) -> FloatArray:
    """Return the move back."""
    turn = pose[:3, :3].T
    return make_pose(turn, -turn @ pose[:3, 3])


def step_pose(pose: FloatArray, step: FloatArray, middle: FloatArray) -> FloatArray:
    """Return a pose after a small turn about a place (radians about x, y, z) and shift, (6,)."""
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    return make_pose(turn, middle - turn @ middle + step[3:]) @ pose


def difference(first: FloatArray, second: FloatArray, positions: FloatArray) -> float:
    """Return how far apart two poses place positions: root mean square."""
    gaps = move(first, positions) - move(second, positions)
    return float(np.sqrt((gaps**2).sum(axis=1).mean()))
