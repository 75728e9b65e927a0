"""A mesh that is written block after block, so that it need never be in memory as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import field, replace
from tempfile import TemporaryFile
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.frame import finite_bounds, scale_heights
from hpcapp.io.meshes.texture import Texture
from hpccomponent.dataclass import dataclass
from hpccomponent.files.held_folders import temporary_room
from hpccomponent.posix import reserve

_ROWS_AT_ONCE = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class MeshStream:
    """A triangle mesh whose rows come in blocks of any size, in order.

    Parameters
    ----------
    origin : ndarray of float64, shape (3,)
        To be added to the vertices for the input's own coordinates.
    box : ndarray of float64, shape (2, 3)
        The lowest and highest finite coordinates of the vertices; zeros where there are none.
    vertices : callable
        Returns blocks of vertices, in the local frame, with what they carry.
    faces : callable
        Returns blocks of faces, shape (n, 3).
    corners : callable
        Returns blocks of the faces' corners, shape (n, 3, 3), in the local frame.
    layout : PointCloud
        Without points: tells which normals, colours and attributes the vertices carry.
    crs : Crs
        What the input's coordinates mean.
    shift : ndarray of float64, shape (3,)
        What was subtracted from the input's coordinates, to be written elsewhere.
    up : str
        Of `axis_names.AXES`.
    """

    vertex_count: int
    face_count: int
    origin: FloatArray
    box: FloatArray
    vertices: Callable[[], Iterator[PointCloud]]
    faces: Callable[[], Iterator[IntArray]]
    corners: Callable[[], Iterator[FloatArray]]
    layout: PointCloud = field(default_factory=lambda: PointCloud(np.empty((0, 3))))
    crs: Crs = UNKNOWN
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))
    up: str = "z"
    texture: Texture | None = None

    @property
    def said(self) -> dict[str, str]:
        """What a file may say of its coordinates, by name, on one line each."""
        if not self.shift.any():
            return self.crs.stated
        places = (np.format_float_positional(part, trim="-") for part in self.shift)
        return {"origin": " ".join(places), **self.crs.stated}


def as_stream(mesh: Mesh | MeshStream) -> MeshStream:
    """Return a mesh as a stream of views of it, of some 65000 rows, and a stream as it is."""
    if isinstance(mesh, MeshStream):
        return mesh
    vertices = find_vertices(mesh)
    return MeshStream(
        len(mesh.vertices),
        len(mesh.faces),
        mesh.origin,
        np.stack(finite_bounds(mesh.vertices)),
        lambda: map(vertices.view, _blocks(len(mesh.vertices))),
        lambda: (mesh.faces[rows] for rows in _blocks(len(mesh.faces))),
        lambda: (mesh.vertices[mesh.faces[rows]] for rows in _blocks(len(mesh.faces))),
        vertices.view(slice(0)),
    )


def scale_mesh_heights(stream: MeshStream, factor: float) -> MeshStream:
    """Return a mesh with z multiplied by a factor, and its normals across its faces."""
    if factor == 1.0:
        return stream
    scales = np.array([1.0, 1.0, factor])
    return replace(
        stream,
        origin=stream.origin * scales,
        box=stream.box * scales,
        vertices=lambda: (scale_heights(block, factor) for block in stream.vertices()),
        corners=lambda: (block * scales for block in stream.corners()),
    )


def find_vertices(mesh: Mesh) -> PointCloud:
    """Return the vertices of a mesh with what they carry, in its local frame."""
    return PointCloud(mesh.vertices, mesh.normals, mesh.colours, mesh.attributes)


def make_mesh(vertices: PointCloud, faces: IntArray, origin: FloatArray) -> Mesh:
    """Return a mesh of vertices in its local frame, with what they carry."""
    columns = (vertices.normals, vertices.colours, vertices.attributes)
    return Mesh(vertices.positions, faces, origin, *columns)


def make_array(shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Return an array of zeros in a file, for what all vertices of a mesh have."""
    shape = tuple(max(rows, 1) for rows in shape)
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    with temporary_room() as room, TemporaryFile(dir=room) as file:  # the array holds it open
        reserve(file, size)
        return np.memmap(file, dtype, "r+", shape=shape)


def _blocks(rows: int) -> Iterator[slice]:
    return (slice(start, start + _ROWS_AT_ONCE) for start in range(0, rows, _ROWS_AT_ONCE))
