"""Sections of a surface from Python, as ``hpcapp section`` draws them."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike, fspath
from pathlib import Path

from hpcapp.api.mesh import Mesh, unwrap_mesh
from hpcapp.applications.section.cut import make_sections
from hpcapp.applications.section.planes import check_cuts
from hpcapp.applications.section.sections import Sections
from hpcapp.io import find_mesh_crs, formats
from hpcapp.io.crs import UNKNOWN
from hpcapp.io.outlines import read_lines
from hpcapp.io.usable_mesh import check_usable
from hpccomponent.ranges import check_range


def section(
    mesh: Mesh | str | PathLike[str],
    planes: str | Sequence[str] = (),
    *,
    along: str | PathLike[str] | None = None,
    step: float | None = None,
    width: float | None = None,
) -> Sections:
    """Return the outlines where planes cut a mesh.

    Parameters
    ----------
    mesh : Mesh, str or PathLike
        A mesh, or its file.
    planes : str or sequence of str
        ``"z=10"``, ``"z"`` for each multiple of the step, or ``"X,Y,Z,DX,DY,DZ"``: a place and the
        direction square to the plane.
    along : str or PathLike, optional
        A file of lines, or WKT: sections are square to them at every step, or along them.
    step, width : float, optional
        Between two sections, and of each across a line.

    Raises
    ------
    InputError
        A file cannot be read, or no plane meets the mesh.
    UsageError
        A plane is none, or arguments do not fit.
    MissingLibraryError
        Lines need shapely.

    Examples
    --------
    >>> import hpcapp
    >>> torus = hpcapp.reconstruct(hpcapp.simulate("torus", points=5000), grid=48)
    >>> ring, = hpcapp.section(torus, "z=0")
    >>> [one.is_closed for one in ring.outlines]
    [True, True]
    """
    check_cuts(planes, along, step, width)
    for name, length in (("step", step), ("width", width)):
        if length is not None:
            check_range(name, length, 0.0, is_open=True)
    if isinstance(mesh, Mesh):
        surface, crs = unwrap_mesh(mesh), UNKNOWN
    else:
        surface, crs = formats.read_mesh(mesh), find_mesh_crs(mesh)
    name = "the mesh" if isinstance(mesh, Mesh) else fspath(mesh)
    check_usable(surface, Path(name))
    typed = [planes] if isinstance(planes, str) else planes
    lines = None if along is None else read_lines(fspath(along))
    return make_sections(surface, crs, typed, lines, step, width, name)
