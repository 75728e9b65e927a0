"""Triangle meshes in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import ByteArray, FloatArray
from hpccomponent.dataclass import dataclass


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
    normals : ndarray of float64, shape (v, 3), or None
        Unit length, pointing out of the object.
    colours : ndarray of uint8, shape (v, 3), or None
        Red, green, blue of the vertices.
    attributes : dict of str to ndarray, shape (v,)
        Any other numbers that the vertices have, by name.
    """

    vertices: FloatArray
    faces: NDArray[np.int64]
    origin: FloatArray = field(default_factory=lambda: np.zeros(3))
    normals: FloatArray | None = None
    colours: ByteArray | None = None
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
