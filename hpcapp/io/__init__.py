"""Point clouds and meshes in files, by suffix.

Readers give values in a local frame (see `frame`); every file is written beside its place and
renamed. Only this package knows formats; it imports `hpccomponent` and nothing else of ours.
"""

from hpcapp.io.formats import (
    MESH_SUFFIXES,
    check_writable,
    describe_losses,
    holds_faces,
    open_points,
    read_mesh,
    read_points,
    write_mesh,
    write_points,
)
from hpcapp.io.frame import needs_double
from hpcapp.io.meshes.mesh_stream import MeshStream
from hpcapp.io.meshes.tiles import TILES_SUFFIX, shared_tiles, write_tiles
from hpcapp.io.ply.format import shared_ply
from hpcapp.io.points.point_source import PointSource, read_whole
from hpcapp.io.points.usable import Dropped, drop_unusable, take_finite

__all__ = [
    "MESH_SUFFIXES",
    "TILES_SUFFIX",
    "Dropped",
    "MeshStream",
    "PointSource",
    "check_writable",
    "describe_losses",
    "drop_unusable",
    "holds_faces",
    "needs_double",
    "open_points",
    "read_mesh",
    "read_points",
    "read_whole",
    "shared_ply",
    "shared_tiles",
    "take_finite",
    "write_mesh",
    "write_points",
    "write_tiles",
]
