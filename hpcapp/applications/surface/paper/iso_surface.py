"""Marching cubes over a whole grid of nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.paper.indicator_blend import NodeGrid
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import JobError


def extract_iso_surface(
    values: NDArray[np.float32], nodes: NodeGrid, origin: FloatArray | None = None
) -> Mesh:
    """Extract the 0-level iso-surface, its faces anticlockwise as seen from outside.

    `values` has the grid's shape, negative inside; where one is exactly 0, the surface has open
    edges. The mesh's `origin`, (3,), is zero if left out. JobError where samples have one sign,
    hence no surface, or are NaN.
    """
    # skimage meshes NaN without a word.
    if not np.isfinite(values).all():
        raise JobError(
            "the implicit function is not finite everywhere", "look for a degenerate patch"
        )
    if not values.min() < 0.0 < values.max():
        raise JobError(
            "the implicit function has one sign on the whole grid, so the surface is empty",
            "use a finer grid, and make sure that the normals point out of the object",
        )
    from skimage import measure  # heavy

    marching_cubes: Any = measure.marching_cubes  # without type hints
    # Of its two windings "descent" is the one that shows its front to the positive side.
    vertices, faces, _, _ = marching_cubes(values, level=0.0, gradient_direction="descent")
    # (v, 3) in grid units, float32: in length units from here
    return Mesh(
        nodes.low + nodes.step * vertices.astype(np.float64),
        faces.astype(np.int64),
        np.zeros(3) if origin is None else origin,
    )
