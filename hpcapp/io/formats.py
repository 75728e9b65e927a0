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
from hpcapp.io.crs import METRES, Crs
from hpcapp.io.frame import check_coordinates
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.output import list_mesh_files, list_point_files
from hpcapp.io.placement import BESIDE, Placement, bring_back, find_crs_beside, note_origin
from hpcapp.io.points.point_source import PointSource, Scan, read_whole, translated
from hpcapp.io.points.recognition import recognise
from hpcapp.io.registry import (
    find_mesh_reader,
    find_mesh_writer,
    find_point_reader,
    find_point_writer,
    list_suffixes,
)
from hpcapp.io.text.endings import find_cut, warn_of_cut
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import InputError, UsageError
from hpccomponent.files.outputs import STANDARD_INPUT, check_files

log = logging.getLogger("hpcapp")

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


def open_points(path: str | PathLike[str], *, keeps_noise: bool = False) -> PointSource:
    """Open a point cloud to read it in parts; path and errors as of `read_points`.

    Parts are in the file's coordinates, and hold every point of it but missing returns, and what
    the file says is noise by its class unless that is kept; what columns hold was found out
    (`recognise`).
    """
    if os.fspath(path) in STANDARD_INPUT:
        raise UsageError(
            f"{path}: points are not read from the standard input", "write them to a file first"
        )
    reader = find_point_reader(Path(path))
    with translated(Path(path)):
        _refuse_special(Path(path))
        source = recognise(reader.open(Path(path), keeps_noise=keeps_noise))
        if cut := find_cut(Path(path)):
            source.findings.warn(cut)
    return source


def holds_faces(path: str | PathLike[str]) -> bool:
    """Tell whether a file is read as a mesh; InputError where it cannot be opened."""
    file = Path(path)
    with translated(file):
        _refuse_special(file)
        if file.suffix.lower() not in MESH_SUFFIXES:
            return False
        return find_mesh_reader(file).has_faces(file)


def find_mesh_crs(path: str | PathLike[str]) -> Crs:
    """Return what the coordinates of a mesh mean, as a PLY says, or the file beside it.

    Errors are those of `read_mesh`.
    """
    file = Path(path)
    reader = find_mesh_reader(file)
    with translated(file):
        _refuse_special(file)
        crs = reader.find_crs(file)
        return crs if crs.stated else find_crs_beside(file)


def find_mesh_up(path: str | PathLike[str]) -> str | None:
    """Return the axis that points up in a mesh, where its file says so; errors of `read_mesh`."""
    file = Path(path)
    reader = find_mesh_reader(file)
    with translated(file):
        _refuse_special(file)
        return reader.find_up(file)


def read_mesh(path: str | PathLike[str]) -> Mesh:
    """Read a triangle mesh: .ply, .obj, .off, .stl, .glb, .vtp; polygons become triangle fans.

    It is in the input's coordinates, as a file beside it says (see `placement`); those far from
    zero are relative to `origin`. Raise InputError where the file cannot be opened, is damaged or
    holds no faces, and UsageError where the suffix is unknown.
    """
    reader = find_mesh_reader(Path(path))
    with translated(Path(path)):
        _refuse_special(Path(path))
        mesh = bring_back(Path(path), reader.read(Path(path)))
        warn_of_cut(Path(path))
    check_coordinates(mesh.origin, path, "the middle of the mesh")
    return mesh


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


def write_mesh(
    path: str | PathLike[str], mesh: Mesh | MeshStream, placement: Placement | None = None
) -> None:
    """Write a mesh: .ply, .off, .vtp in the input's coordinates, .glb, .obj, .stl, .3mf near zero.

    What was subtracted is in a file beside it (see `placement`). ``.3dtiles`` makes a folder for
    web viewers (`write_tileset`), ``.tiles`` one with the mesh as one tile (`write_tiles`). What
    its vertices carry and the format does not hold is logged as a warning. The same mesh gives the
    same bytes; a file appears whole or not at all. Raise OutputError where the suffix is unknown,
    or the file cannot be written.
    """
    stream = place_mesh(path, mesh, placement)
    for loss in describe_losses(path, stream):
        log.warning("warning: %s", loss)
    find_mesh_writer(Path(path)).write(Path(path), stream)
    note_place(path, stream)
    if (size := describe_printed_size(path, stream)) is not None:
        log.info("%s", size)


def place_mesh(
    path: str | PathLike[str], mesh: Mesh | MeshStream, placement: Placement | None = None
) -> MeshStream:
    """Return a mesh where a file of it is written, and which way up."""
    writer = find_mesh_writer(Path(path))
    return (placement or Placement()).place(as_stream(mesh), writer.is_near, writer.turns)


def note_place(path: str | PathLike[str], placed: MeshStream) -> None:
    """Write beside a mesh what its file does not say of its place, and log it."""
    is_bare = find_mesh_writer(Path(path)).is_bare
    note_origin(Path(path), placed.shift, placed.crs, holds_crs=not is_bare)
    if placed.shift.any():
        log.info("%s: relative to %s, as %s%s says", path, placed.said["origin"], path, BESIDE)
    if placed.up != "z":
        log.info("%s: %s is up", path, placed.up)


def describe_losses(path: str | PathLike[str], mesh: MeshStream) -> list[str]:
    """Say in a line each what a mesh that was placed has and its file does not hold."""
    writer = find_mesh_writer(Path(path))
    losses = []
    if lost := writer.find_losses(mesh.layout):
        others = list_suffixes(lambda one: one.mesh_writer and one.mesh_writer.holds_all)
        losses.append(_say_losses(path, lost, "vertices", others))
    if writer.is_bare and mesh.origin.any():
        step = float(np.spacing(np.float32(np.abs(mesh.box + mesh.origin).max())))
        losses.append(f"{path}: single precision rounds its coordinates to {step:.2g}")
    return losses


def describe_printed_size(path: str | PathLike[str], mesh: MeshStream) -> str | None:
    """Say in millimetres what a slicer makes of a mesh whose file does not say another unit.

    None where it does, or the mesh has millimetres.
    """
    suffix, unit = Path(path).suffix.lower(), mesh.crs.unit
    if suffix not in (".stl", ".3mf") or unit == "mm" or (suffix == ".3mf" and unit in METRES):
        return None
    sides = " x ".join(f"{side:.3g}" for side in mesh.box[1] - mesh.box[0])
    why = f"its {unit} are" if unit else "no unit is known, which is"
    return f"{path}: {sides} mm to a slicer: {why} read as mm; {name_option('print')} scales it"


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

    Raise OutputError where the suffix is unknown, the folder does not exist or cannot be written,
    or `path`, or a name beside it, is not a file.
    """
    lists = list_mesh_files if kind == "mesh" else list_point_files
    check_files([*lists(Path(path))])


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
