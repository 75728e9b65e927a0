"""Point formats: one line each.

A format names its suffixes and the function that opens a file of it, which is imported when a
file of it is opened. A how-to page shows how to add one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import cast

from hpcapp.io.points.point_source import PointSource
from hpccomponent.errors import UsageError

__all__ = ["POINT_FORMATS", "PointFormat", "find_point_format"]


@dataclass(frozen=True, slots=True)
class PointFormat:
    """A format that points are read from.

    Parameters
    ----------
    name : str
        For people.
    suffixes : tuple of str
        In lower case, with the dot.
    opener : str
        ``module:function``: given a path, it returns a `PointSource`.
    least_bytes : float
        Fewest bytes of the file that a point takes: a bound of how many there can be, where the
        file does not say.
    streams : bool
        Whether it is read in parts, so that a file may be larger than memory.
    states_count : bool
        Whether the start of a file says how many points there are.
    needs_library : bool
        Whether it is read with a library that is not everywhere where this package is.
    """

    name: str
    suffixes: tuple[str, ...]
    opener: str
    least_bytes: float
    streams: bool = True
    states_count: bool = False
    needs_library: bool = False

    def open(self, path: Path) -> PointSource:
        """Open a file of this format.

        Raises
        ------
        InputError
            The file is damaged.
        UsageError
            The library that reads it is not installed; the message says how to install it.
        OSError
            The file cannot be read.
        """
        module, _, name = self.opener.partition(":")
        opener = cast(Callable[[Path], PointSource], getattr(import_module(module), name))
        return opener(path)


_TEXT = (".xyz", ".txt", ".asc", ".pts", ".csv", ".xyzn", ".xyzrgb", ".xyzi", ".pwn")

POINT_FORMATS = (
    PointFormat("PLY", (".ply",), "hpcapp.io.ply.points:open_ply", 3, states_count=True),
    PointFormat("text", _TEXT, "hpcapp.io.text.points:open_text", 6),
    PointFormat("PTX", (".ptx",), "hpcapp.io.text.ptx:open_ptx", 6),
    PointFormat("LAS", (".las",), "hpcapp.io.las.points:open_las", 20, states_count=True),
    PointFormat(
        "LAZ",
        (".laz",),
        "hpcapp.io.las.points:open_las",
        0.25,
        states_count=True,
        needs_library=True,
    ),
    PointFormat(
        "E57", (".e57",), "hpcapp.io.e57.points:open_e57", 1, states_count=True, needs_library=True
    ),
    PointFormat("OBJ", (".obj",), "hpcapp.io.points.mesh_points:open_obj", 8, streams=False),
    PointFormat("STL", (".stl",), "hpcapp.io.points.mesh_points:open_stl", 8, streams=False),
    PointFormat("OFF", (".off",), "hpcapp.io.points.mesh_points:open_off", 6, streams=False),
    PointFormat("VTK", (".vtk",), "hpcapp.io.points.vtk:open_vtk", 6, streams=False),
    PointFormat("PCD", (".pcd",), "hpcapp.io.points.pcd:open_pcd", 3, states_count=True),
    PointFormat("NumPy", (".npy", ".npz"), "hpcapp.io.points.npy:open_npy", 3, states_count=True),
)


def find_point_format(path: Path) -> PointFormat:
    """Return the format of a file by its suffix, in any case.

    Raises
    ------
    UsageError
        The suffix is unknown.
    """
    suffix = path.suffix.lower()
    for known in POINT_FORMATS:
        if suffix in known.suffixes:
            return known
    suffixes = [suffix for known in POINT_FORMATS for suffix in known.suffixes]
    named = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
    raise UsageError(f"{path}: {named}", f"a point cloud is read from {', '.join(suffixes)}")
