"""Copies of a mesh for trimesh, Open3D and PyVista, none of which is needed otherwise."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from hpccomponent.errors import MissingLibraryError

if TYPE_CHECKING:
    from hpcapp.api.mesh import Mesh


def _load(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise MissingLibraryError(
            f"to_{name} needs the package {name} ({error})", f"pip install {name}"
        ) from error


def to_trimesh(mesh: Mesh) -> Any:
    """Return a ``trimesh.Trimesh``, whose vertices stay as they are."""
    return _load("trimesh").Trimesh(
        vertices=mesh.vertices.copy(),
        faces=mesh.faces.copy(),
        vertex_normals=None if mesh.normals is None else mesh.normals.copy(),
        vertex_colors=None if mesh.colours is None else mesh.colours.copy(),
        vertex_attributes={name: column.copy() for name, column in mesh.attributes.items()},
        process=False,
    )


def to_open3d(mesh: Mesh) -> Any:
    """Return an ``open3d.geometry.TriangleMesh``."""
    open3d = _load("open3d")
    rows = open3d.utility.Vector3dVector
    copy = open3d.geometry.TriangleMesh(
        rows(mesh.vertices.copy()), open3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    )
    if mesh.normals is not None:
        copy.vertex_normals = rows(mesh.normals.copy())
    if mesh.colours is not None:
        copy.vertex_colors = rows(mesh.colours / 255.0)
    return copy


def to_pyvista(mesh: Mesh) -> Any:
    """Return a ``pyvista.PolyData``."""
    pyvista = _load("pyvista")
    copy = pyvista.PolyData.from_regular_faces(mesh.vertices.copy(), mesh.faces.copy())
    for name, column in mesh.attributes.items():
        copy.point_data[name] = column.copy()
    if mesh.normals is not None:
        copy.point_data["Normals"] = mesh.normals.copy()
    if mesh.colours is not None:
        copy.point_data["RGB"] = mesh.colours.copy()
    return copy
