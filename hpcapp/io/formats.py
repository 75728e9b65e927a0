"""Which suffix means which format; foreign errors end here."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal, TypeVar

from hpcapp.io.meshes.glb import write_glb
from hpcapp.io.meshes.glb_reader import read_glb
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.meshes.obj import holds_obj_faces, read_obj, write_obj
from hpcapp.io.meshes.off import read_off, write_off
from hpcapp.io.meshes.stl import read_stl, write_stl
from hpcapp.io.meshes.threemf import write_3mf
from hpcapp.io.meshes.tiles import TILES_SUFFIX, check_tiles, write_tiles
from hpcapp.io.meshes.tileset import TILESET_SUFFIX, write_tileset
from hpcapp.io.meshes.vtp import write_vtp
from hpcapp.io.meshes.vtp_reader import read_vtp
from hpcapp.io.ply.format import holds_ply_faces, read_ply_mesh, write_ply_mesh
from hpcapp.io.point_writers import POINT_WRITERS
from hpcapp.io.points.point_source import PointSource, Scan, read_whole, translated
from hpcapp.io.points.recognition import recognise
from hpcapp.io.points.registry import find_point_format
from hpcapp.io.staging import check_place
from hpccomponent.errors import InputError, OutputError, UsageError
from hpccomponent.surface.types.mesh import Mesh
from hpccomponent.surface.types.points import PointCloud

__all__ = [
    "MESH_SUFFIXES",
    "STANDARD_INPUT",
    "check_writable",
    "describe_losses",
    "holds_faces",
    "open_points",
    "read_mesh",
    "read_points",
    "write_mesh",
    "write_points",
]

log = logging.getLogger("hpcapp")

Chosen = TypeVar("Chosen")

STANDARD_INPUT = ("-", "/dev/stdin", "/dev/fd/0", "/proc/self/fd/0")
"""Its names."""

_MESH_READERS: dict[str, Callable[[Path], Mesh]] = {
    ".ply": read_ply_mesh,
    ".obj": read_obj,
    ".off": read_off,
    ".stl": read_stl,
    ".glb": read_glb,
    ".vtp": read_vtp,
}


MESH_SUFFIXES = tuple(_MESH_READERS)
"""Of the files that meshes are read from."""


@dataclass(frozen=True, slots=True)
class _MeshWriter:
    """A format that meshes are written to, and which columns of vertices it holds."""

    write: Callable[[Path, Mesh | MeshStream], None]
    holds_normals: bool = False
    holds_colours: bool = False
    holds_attributes: bool = False

    @property
    def holds_all(self) -> bool:
        return self.holds_normals and self.holds_colours and self.holds_attributes


_MESH_WRITERS: dict[str, _MeshWriter] = {
    ".ply": _MeshWriter(write_ply_mesh, True, True, True),
    ".obj": _MeshWriter(write_obj, True, True),
    ".off": _MeshWriter(write_off),
    ".stl": _MeshWriter(write_stl),
    ".glb": _MeshWriter(write_glb, True, True, True),
    ".vtp": _MeshWriter(write_vtp, True, True, True),
    ".3mf": _MeshWriter(write_3mf, False, True),
    TILESET_SUFFIX: _MeshWriter(write_tileset, True, True, True),
    TILES_SUFFIX: _MeshWriter(
        lambda path, mesh: write_tiles(path, [(0, as_stream(mesh))]), False, True, True
    ),
}


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
    """Open a point cloud to read it in parts; see `read_points` for the formats.

    Parameters
    ----------
    path : str or PathLike
        The suffix, in any case, chooses the format.

    Returns
    -------
    PointSource
        Its parts are in the file's coordinates, and hold every point of it but missing returns;
        what its columns hold was found out (see `recognise`).

    Raises
    ------
    InputError
        The file cannot be opened, its start is damaged, or it holds no points.
    UsageError
        The suffix is unknown.
    """
    if os.fspath(path) in STANDARD_INPUT:
        raise UsageError(
            f"{path}: points are not read from the standard input", "write them to a file first"
        )
    point_format = find_point_format(Path(path))
    with translated(Path(path)):
        _refuse_special(Path(path))
        return recognise(point_format.open(Path(path)))


def holds_faces(path: str | PathLike[str]) -> bool:
    """Tell whether a file is read as a mesh, and not as points alone.

    Parameters
    ----------
    path : str or PathLike
        The suffix, in any case, chooses the format.

    Returns
    -------
    bool
        Of a PLY or an OBJ, what the file holds decides.

    Raises
    ------
    InputError
        The file cannot be opened, or its start is damaged.
    """
    file, suffix = Path(path), Path(path).suffix.lower()
    with translated(file):
        _refuse_special(file)
        if suffix == ".ply":
            return holds_ply_faces(file)
        if suffix == ".obj":
            return holds_obj_faces(file)
    return suffix in _MESH_READERS


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
    reader = _choose(_MESH_READERS, Path(path), UsageError, "a mesh is read from")
    with translated(Path(path)):
        _refuse_special(Path(path))
        return reader(Path(path))


def write_points(
    path: str | PathLike[str],
    cloud: PointCloud,
    crs: str | None = None,
    unit: str | None = None,
    scans: Sequence[Scan] = (),
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

    Raises
    ------
    OutputError
        The suffix is unknown, or the file cannot be written.
    UsageError
        The library that writes the format is not installed.
    """
    writer = _choose(POINT_WRITERS, Path(path), OutputError, "a point cloud is written to")
    if lost := writer.find_losses(cloud, crs, unit, scans):
        log.warning("warning: %s", _say_losses(path, lost, "points", [".ply"]))
    writer.write(Path(path), cloud, crs, unit, scans)


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
    writer = _choose(_MESH_WRITERS, Path(path), OutputError, "a mesh is written to")
    stream = as_stream(mesh)
    if losses := describe_losses(path, stream.layout):
        log.warning("warning: %s", losses)
    writer.write(Path(path), stream)


def describe_losses(path: str | PathLike[str], layout: PointCloud) -> str | None:
    """Say what a mesh's vertices carry that the format of a file does not hold.

    Parameters
    ----------
    path : str or PathLike
        The suffix chooses the format.
    layout : PointCloud
        Without points; see `MeshStream`.

    Returns
    -------
    str or None
        One line; None where all is held.
    """
    writer = _choose(_MESH_WRITERS, Path(path), OutputError, "a mesh is written to")
    lost = ["normals"] if layout.normals is not None and not writer.holds_normals else []
    lost += ["colours"] if layout.colours is not None and not writer.holds_colours else []
    lost += [] if writer.holds_attributes else layout.attributes
    if not lost:
        return None
    others = [suffix for suffix, other in _MESH_WRITERS.items() if other.holds_all]
    return _say_losses(path, lost, "vertices", others)


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

    Parameters
    ----------
    path : str or PathLike
        Where the result shall appear.
    kind : {"mesh", "points"}
        What it will be.

    Raises
    ------
    OutputError
        The suffix is unknown, the folder does not exist or cannot be written, or `path` is
        not a file.
    """
    if kind == "mesh":
        _choose(_MESH_WRITERS, Path(path), OutputError, "a mesh is written to")
    else:
        _choose(POINT_WRITERS, Path(path), OutputError, "a point cloud is written to")
    if Path(path).suffix.lower() in (TILES_SUFFIX, TILESET_SUFFIX):
        check_tiles(Path(path))
    else:
        check_place(Path(path))


def _choose(
    by_suffix: Mapping[str, Chosen], path: Path, error: type[UsageError], sentence: str
) -> Chosen:
    chosen = by_suffix.get(path.suffix.lower())
    if chosen is None:
        named = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise error(f"{path}: {named}", f"{sentence} {', '.join(by_suffix)}")
    return chosen


def _refuse_special(path: Path) -> None:
    """Refuse pipes and devices: a reader looks at its file twice, and would wait for ever."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a regular file", "write it to a file first")
