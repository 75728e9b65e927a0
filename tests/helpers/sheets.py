"""Open sheets over a grid of rows and columns, which face up."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray


def grid_faces(rows: int, columns: int) -> IntArray:
    """Two triangles for each cell of a grid whose vertices are numbered row after row."""
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    return np.concatenate([np.stack(k, -1).reshape(-1, 3) for k in ((a, b, c), (a, c, d))])


def sweep(profile: FloatArray, width: float, rows: int = 9) -> Mesh:
    """A profile of x and z, (n, 2), drawn along y from zero on."""
    x, z = profile.T
    y = np.repeat(np.linspace(0.0, width, rows), len(x))
    return Mesh(np.stack([np.tile(x, rows), y, np.tile(z, rows)], axis=1), grid_faces(rows, len(x)))
