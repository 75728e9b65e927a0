"""Point clouds and meshes in files, by suffix.

Readers give values in a local frame (see `frame`); every file is written beside its place and
renamed. Only this package knows formats; it imports `hpccomponent` and nothing else of ours.
"""

from hpcapp.io.formats import (
    check_writable,
    open_points,
    read_mesh,
    read_points,
    write_mesh,
    write_points,
)
from hpcapp.io.point_source import PointSource
from hpcapp.io.usable import Dropped, drop_unusable

__all__ = [
    "Dropped",
    "PointSource",
    "check_writable",
    "drop_unusable",
    "open_points",
    "read_mesh",
    "read_points",
    "write_mesh",
    "write_points",
]
