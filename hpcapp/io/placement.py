"""Where a mesh is written, which way up, and the file beside it that brings its place back.

Viewers, game engines and printers hold coordinates in single precision, which has no room for those
of a map: there what lies far from zero is written near zero. The origin is in a file beside it,
``mesh.glb.origin.json``, which `read_mesh` adds again::

    {"origin": [512025.0, 5403025.0, 0.0], "unit": "m", "crs": "EPSG:25832"}
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from msgspec import Meta

from hpcapp.geometry.axes import find_up, measure_faces
from hpcapp.geometry.axis_names import AXES
from hpcapp.geometry.points import FloatArray
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.staging import replacing
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError
from hpccomponent.foreign_json import decode_large
from hpccomponent.ranges import FARTHEST, is_place

if TYPE_CHECKING:
    from hpcapp.geometry.mesh import Mesh

Origin: TypeAlias = "str | tuple[float, float, float]"
"""``auto``, ``keep``, or what is subtracted from the coordinates."""

_Coordinate: TypeAlias = Annotated[float, Meta(ge=-FARTHEST, le=FARTHEST)]
Place: TypeAlias = tuple[_Coordinate, _Coordinate, _Coordinate]
"""A place that a file or a report may name: see `is_place`."""

BESIDE = ".origin.json"
"""Ends the name of the file beside a mesh."""

_MOST_BYTES = 1 << 20  # of that file: the longest WKT has some 10 kB


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a mesh is written, and which way up.

    Parameters
    ----------
    origin : str or tuple of float
        What is subtracted, in the input's coordinates; ``auto`` subtracts the origin of the local
        frame in formats that are read in single precision; ``keep`` nothing in any format.
    up : str or None
        The axis of the input that points up, of `axis_names.AXES`; by default see `choose_up`.
    """

    origin: Origin = "auto"
    up: str | None = None

    @property
    def is_asked(self) -> bool:
        """Whether a place is asked for that the format alone would not give."""
        return not isinstance(self.origin, str)

    def with_up(self, axis: str | None) -> Placement:
        """Return the same with the axis that is known to point up where none is asked for."""
        return replace(self, up=self.up or axis)

    def place(self, stream: MeshStream, is_near: bool, turns: bool) -> MeshStream:
        """Return a mesh, in the input's coordinates, where it is written.

        A format is near where it is read in single precision, and turns where it says which axis is
        up.
        """
        if self.origin == "keep" or (self.origin == "auto" and not is_near):
            shift = np.zeros(3)
        else:
            shift = stream.origin if self.origin == "auto" else np.array(self.origin, float)
        up = choose_up(stream, self.up) if turns else "z"
        return replace(stream, origin=stream.origin - shift, shift=shift, up=up)


def choose_up(mesh: Mesh | MeshStream, asked: str | None = None) -> str:
    """Return the axis of a mesh without a job that points up: as asked, z of a map, else as found.

    It is asked by the user, or said by the mesh's file.
    """
    if asked is not None:
        return asked
    stream = as_stream(mesh)
    return "z" if stream.crs.text else find_up(map(measure_faces, stream.corners()), stream.box)


def parse_origin(text: str) -> Origin:
    """Return what ``--origin`` says; raise UsageError where it is neither a word nor a place.

    Examples
    --------
    >>> parse_origin("512000,5403000,0")
    (512000.0, 5403000.0, 0.0)
    """
    if text in ("auto", "keep"):
        return text
    try:
        x, y, z = (float(word) for word in text.split(","))
    except ValueError:
        x = y = z = np.nan
    if not is_place(x, y, z):
        asked = name_option("origin", repr(text))
        advice = f"give auto, keep, or X,Y,Z, numbers up to {FARTHEST:.0e}"
        raise UsageError(f"{asked}: is no place", advice)
    return x, y, z


def check_up(axis: str) -> str:
    """Return an axis; UsageError where it is none."""
    if axis not in AXES:
        raise UsageError(f"up {axis!r}: is no axis", f"give one of {', '.join(AXES)}")
    return axis


@dataclass(frozen=True, slots=True)
class _Beside:
    """What is in the file beside a mesh."""

    origin: Place
    unit: str | None = None
    height_unit: str | None = None
    crs: str | None = None


def note_origin(path: Path, origin: FloatArray, crs: Crs, holds_crs: bool = True) -> None:
    """Write what a mesh's file does not say into the one beside it; remove one that is out of date.

    That is the origin (3,) that was subtracted, and the crs, unless the mesh's file holds it.
    """
    beside = name_beside(path)
    if origin.any() or (crs.stated and not holds_crs):
        with replacing(beside) as file:
            text = json.dumps({"origin": origin.tolist(), **crs.stated}, indent=1)
            file.write(text.encode() + b"\n")
    else:
        beside.unlink(missing_ok=True)


def bring_back(path: Path, mesh: Mesh) -> Mesh:
    """Return a mesh that was read from a file in the coordinates of its input."""
    beside = _read_beside(path)
    return mesh if beside is None else replace(mesh, origin=mesh.origin + beside.origin)


def find_crs_beside(path: Path) -> Crs:
    """Return what the file beside a mesh says of its coordinates."""
    beside = _read_beside(path)
    return UNKNOWN if beside is None else Crs(beside.crs, beside.unit, beside.height_unit)


def name_beside(path: Path) -> Path:
    """Return the file beside a mesh."""
    return path.with_name(path.name + BESIDE)


def _read_beside(path: Path) -> _Beside | None:
    beside = name_beside(path)
    if not beside.is_file():
        return None
    try:
        if beside.stat().st_size > _MOST_BYTES:
            raise ValueError("too large")
        return decode_large(beside.read_bytes(), _Beside)
    except ValueError as error:
        raise InputError(
            f"{beside}: does not say where {path.name} is: {error}",
            "remove it to take the mesh as it is, or write the mesh again",
        ) from None
