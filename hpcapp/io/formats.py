"""Points and meshes read from files and written to them; foreign errors end here."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io.crs import Crs
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.points.point_source import PointSource, Scan, read_whole, translated
from hpcapp.io.points.recognition import recognise
from hpcapp.io.registry import (
    find_mesh_reader,
    find_mesh_writer,
    find_point_reader,
    find_point_writer,
    list_suffixes,
)
from hpcapp.io.staging import check_folder, check_place
from hpccomponent.errors import InputError, UsageError

log = logging.getLogger("hpcapp")

STANDARD_INPUT = ("-", "/dev/stdin", "/dev/fd/0", "/proc/self/fd/0")
"""Its names."""

MESH_SUFFIXES = list_suffixes(lambda one: one.mesh_reader)
"""Of the files that meshes are read from."""

FOLDER_SUFFIXES = list_suffixes(lambda one: one.mesh_writer and one.mesh_writer.makes_folder)
"""Of the outputs that are folders."""


def read_points(path: str | PathLike[str]) -> PointCloud:
    """Read a point cloud, or the vertices of a mesh.

    Parameters
    ----------
    path : str or PathLike
        The suffix, in any case, chooses the format.

    Returns
    -------
    PointCloud
        Every point of the file, NaN and zero normals included (see `drop_unusable`).
        Coordinates far from zero are relative to `origin`.

    Raises
    ------
    InputError
        The file cannot be opened, is damaged or holds no points.
    UsageError
        The suffix is unknown.
    """
    return read_whole(open_points(path))


def open_points(path: str | PathLike[str]) -> PointSource:
    """Open a point cloud to read it in parts; path and errors as of `read_points`.

    Returns
    -------
    PointSource
        Its parts are in the file's coordinates, and hold every point of it but missing returns;
        what its columns hold was found out (see `recognise`).
    """
    if os.fspath(path) in STANDARD_INPUT:
        raise UsageError(
            f"{path}: points are not read from the standard input", "write them to a file first"
        )
    reader = find_point_reader(Path(path))
    with translated(Path(path)):
        _refuse_special(Path(path))
        return recognise(reader.open(Path(path)))


def holds_faces(path: str | PathLike[str]) -> bool:
    """Tell whether a file is read as a mesh; InputError where it cannot be opened."""
    file = Path(path)
    with translated(file):
        _refuse_special(file)
        if file.suffix.lower() not in MESH_SUFFIXES:
            return False
        return find_mesh_reader(file).has_faces(file)


def find_mesh_crs(path: str | PathLike[str]) -> Crs:
    """Return what the coordinates of a mesh's file mean, as a PLY says; errors of `read_mesh`."""
    file = Path(path)
    reader = find_mesh_reader(file)
    with translated(file):
        _refuse_special(file)
        return reader.find_crs(file)


def read_mesh(path: str | PathLike[str]) -> Mesh:
    """Read a triangle mesh: .ply, .obj, .off, .stl, .glb, .vtp; polygons become triangle fans.

    Parameters
    ----------
    path : str or PathLike
        The suffix, in any case, chooses the format.

    Returns
    -------
    Mesh
        Coordinates far from zero are relative to `origin`.

    Raises
    ------
    InputError
        The file cannot be opened, is damaged or holds no faces.
    UsageError
        The suffix is unknown.
    """
    reader = find_mesh_reader(Path(path))
    with translated(Path(path)):
        _refuse_special(Path(path))
        return reader.read(Path(path))


def write_points(
    path: str | PathLike[str],
    cloud: PointCloud,
    crs: str | None = None,
    unit: str | None = None,
    scans: Sequence[Scan] = (),
    height_unit: str | None = None,
) -> None:
    """Write a point cloud, in the input's coordinates.

    The formats are .ply, .las, .laz, .e57, .npz, .xyz, .txt, .asc and .pts. What the cloud has and
    the format does not hold is logged as a warning.

    Parameters
    ----------
    path : str or PathLike
        The suffix chooses the format. The file appears whole or not at all.
    cloud : PointCloud
        May lack normals and colours.
    crs : str, optional
        Coordinate reference system, as WKT or an EPSG code.
    unit : str, optional
        Of the coordinates: ``m``, ``ft``, ``US ft``, ``mm``, ``cm``, ``km``.
    scans : sequence of Scan
        Where the scanners stood.
    height_unit : str, optional
        Of z, where it has another unit.

    Raises
    ------
    OutputError
        The suffix is unknown, or the file cannot be written.
    MissingLibraryError
        The library that writes the format is not installed.
    """
    writer = find_point_writer(Path(path))
    if lost := writer.find_losses(cloud, Crs(crs, unit, height_unit), scans):
        log.warning("warning: %s", _say_losses(path, lost, "points", [".ply"]))
    writer.write(Path(path), cloud, crs, unit, scans, height_unit)


def write_mesh(path: str | PathLike[str], mesh: Mesh | MeshStream) -> None:
    """Write a mesh: .ply, .obj, .off, .vtp in the input's coordinates, .stl in the local frame.

    ``.glb`` and ``.3mf`` are in the local frame, too, and say where that is; ``.3dtiles`` makes a
    folder for web viewers (see `write_tileset`), ``.tiles`` makes a folder with the
    mesh as one tile (see `write_tiles`). What its vertices carry and the format does not hold is
    logged as a warning.

    Parameters
    ----------
    path : str or PathLike
        The suffix chooses the format. The file appears whole or not at all.
    mesh : Mesh or MeshStream
        In memory, or block after block. The same mesh gives the same bytes.

    Raises
    ------
    OutputError
        The suffix is unknown, or the file cannot be written.
    """
    writer = find_mesh_writer(Path(path))
    stream = as_stream(mesh)
    for loss in describe_losses(path, stream):
        log.warning("warning: %s", loss)
    writer.write(Path(path), stream)


def describe_losses(path: str | PathLike[str], mesh: MeshStream) -> list[str]:
    """Say in a line each what a mesh has that its file does not hold, and what that means."""
    writer = find_mesh_writer(Path(path))
    losses = []
    if lost := writer.find_losses(mesh.layout):
        others = list_suffixes(lambda one: one.mesh_writer and one.mesh_writer.holds_all)
        losses.append(_say_losses(path, lost, "vertices", others))
    if not writer.has_frame and mesh.crs.stated:
        kept = ", ".join(mesh.crs.stated)
        losses.append(f"{path}: {Path(path).suffix} does not say what coordinates mean: {kept}")
    if not writer.has_frame and mesh.origin.any():
        shift = " ".join(np.format_float_positional(part, trim="-") for part in mesh.origin)
        losses.append(f"{path}: in local coordinates: add {shift} for those of the input")
    return losses


def _say_losses(
    path: str | PathLike[str], lost: Sequence[str], owners: str, others: Sequence[str]
) -> str:
    """Say what a file does not hold, and which formats would."""
    hold = "holds" if len(others) == 1 else "hold"
    return (
        f"{path}: {Path(path).suffix} holds no {', no '.join(lost)} of {owners}: left out; "
        f"{', '.join(others)} {hold} all"
    )


def check_writable(path: str | PathLike[str], kind: Literal["mesh", "points"] = "mesh") -> None:
    """Find out before the work whether its result can be written; leave nothing behind.

    Raises
    ------
    OutputError
        The suffix is unknown, the folder does not exist or cannot be written, or `path` is
        not a file.
    """
    file = Path(path)
    if kind == "mesh" and find_mesh_writer(file).makes_folder:
        check_folder(file)
        return
    if kind == "points":
        find_point_writer(file)
    check_place(file)


def check_holds_texture(output: str) -> None:
    """Raise UsageError where an output does not hold a texture; ``-`` is a PLY."""
    path = Path("mesh.ply" if output == "-" else output)
    if not find_mesh_writer(path).textures:
        others = list_suffixes(lambda one: one.mesh_writer and one.mesh_writer.textures)
        raise UsageError(
            f"{output}: {path.suffix} holds no texture", f"write {' or '.join(others)}"
        )


def _refuse_special(path: Path) -> None:
    """Refuse pipes and devices: a reader looks at its file twice, and would wait for ever."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a regular file", "write it to a file first")
