"""Whether distances from a mesh can be taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpccomponent.errors import InputError

_LARGEST = 1e150  # of a coordinate: the square of a distance is a double, too


def check_usable(mesh: Mesh, path: Path) -> None:
    """Refuse a mesh of which no distances can be taken.

    Raise InputError where it has no faces, or a face's vertex or its square is not finite.
    """
    if not len(mesh.faces):
        raise InputError(f"{path}: holds no faces", "give a mesh")
    if not (np.abs(mesh.vertices[mesh.faces]) < _LARGEST).all():
        raise InputError(
            f"{path}: has vertices that are NaN, infinite or beyond {_LARGEST:g}", "leave them out"
        )
