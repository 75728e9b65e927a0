"""Point clouds and meshes in files, by suffix.

Readers give values in a local frame (see `frame`); every file is written beside its place and
renamed. Only this package knows formats, and imports one when a file of it is read or written; it
imports `hpccomponent` and nothing else of ours.
"""

from hpcapp.geometry.validity import Dropped
from hpcapp.io.formats import (
    FOLDER_SUFFIXES,
    MESH_SUFFIXES,
    check_writable,
    describe_losses,
    find_mesh_crs,
    find_mesh_up,
    holds_faces,
    note_place,
    open_points,
    place_mesh,
    read_mesh,
    read_points,
    write_mesh,
    write_points,
)
from hpcapp.io.frame import needs_double
from hpcapp.io.meshes.mesh_stream import MeshStream
from hpcapp.io.points.point_source import PointSource, read_whole
from hpcapp.io.points.usable import drop_unusable, take_finite

__all__ = [
    "FOLDER_SUFFIXES",
    "MESH_SUFFIXES",
    "Dropped",
    "MeshStream",
    "PointSource",
    "check_writable",
    "describe_losses",
    "drop_unusable",
    "find_mesh_crs",
    "find_mesh_up",
    "holds_faces",
    "needs_double",
    "note_place",
    "open_points",
    "place_mesh",
    "read_mesh",
    "read_points",
    "read_whole",
    "take_finite",
    "write_mesh",
    "write_points",
]
