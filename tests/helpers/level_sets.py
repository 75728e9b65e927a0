"""Meshes of level sets on a grid: closed and manifold, of known shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from skimage import measure

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray

Field = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


def mesh_level_set(field: Field, reach: float, cells: int) -> Mesh:
    """Mesh the zeros of a function that is negative inside, over a cube around the origin."""
    axis = np.linspace(-reach, reach, cells)
    marching_cubes: Any = measure.marching_cubes
    values = field(*np.meshgrid(axis, axis, axis, indexing="ij"))
    vertices, faces, _, _ = marching_cubes(values, 0.0)
    return Mesh(vertices.astype(float) * (axis[1] - axis[0]) - reach, faces.astype(np.int64))
