"""Triangle meshes in memory."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.types.points import FloatArray

__all__ = ["Mesh"]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh in a local frame.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
        In length units of the input, relative to `origin`.
    faces : ndarray of int64, shape (f, 3)
        Vertex indices, anticlockwise as seen from outside.
    origin : ndarray of float64, shape (3,)
        To be added to the vertices for the input's own coordinates.
    """

    vertices: FloatArray
    faces: NDArray[np.int64]
    origin: FloatArray = field(default_factory=lambda: np.zeros(3))
