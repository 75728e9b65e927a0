"""The mesh that users get from Python: measures, files, pages, and what other packages take."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpcapp.api.arrays import check_colours, check_column, check_faces, check_rows, read_only
from hpcapp.api.mesh_page import IN_NOTEBOOK, JobRecord, build_mesh_page, draw_small, frame_page
from hpcapp.applications.surface.attributes.choice import parse_attributes
from hpcapp.applications.surface.stitching.topology import (
    Topology,
    check_mesh,
    signed_volume,
    surface_area,
)
from hpcapp.geometry import mesh as plain
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray, PointCloud
from hpcapp.io import formats
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.frame import to_local
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.io.placement import Placement, check_up, choose_up, parse_origin
from hpcapp.named_files import PAGE, PICTURE
from hpcapp.pages.browser import show_page
from hpcapp.pages.page import write_page
from hpcapp.pages.thin import MOST_FACES
from hpcapp.parts.crop import make_crop
from hpccomponent.errors import UsageError
from hpccomponent.files.outputs import check_files
from hpccomponent.ranges import check_range


class Mesh:
    """A triangle mesh; its arrays cannot be written to.

    Parameters
    ----------
    vertices : array_like, shape (v, 3)
        In any unit and any frame, georeferenced ones too.
    faces : array_like of int, shape (f, 3)
        Rows of `vertices`, anticlockwise as seen from outside.
    normals : array_like, shape (v, 3), optional
    colours : array_like of uint8, shape (v, 3), optional
    attributes : mapping of str to array_like, shape (v,), optional
        Any other numbers that the vertices have, by name.

    Raises
    ------
    InputError
        An array has not this shape, or holds what it cannot.

    Examples
    --------
    >>> import hpcapp
    >>> import numpy as np
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + 1000
    >>> mesh = hpcapp.Mesh(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    >>> mesh
    Mesh(4 vertices, 4 faces, watertight, 1 x 1 x 1)
    >>> round(mesh.volume, 6), round(mesh.area, 6)
    (0.166667, 2.366025)
    >>> mesh.bounds.tolist()
    [[1000.0, 1000.0, 1000.0], [1001.0, 1001.0, 1001.0]]
    """

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        normals: ArrayLike | None = None,
        colours: ArrayLike | None = None,
        attributes: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        positions = check_rows("vertices", vertices)
        count = len(positions)
        local, origin = to_local(positions)
        directions = None if normals is None else check_rows("normals", normals, count)
        columns = {n: check_column(n, c, count) for n, c in (attributes or {}).items()}
        shades = None if colours is None else check_colours(colours, count)
        corners = check_faces(faces, count)
        self._plain = plain.Mesh(local, corners, origin, directions, shades, columns)
        self._job: JobRecord | None = None
        self._crs = UNKNOWN
        self._up: str | None = None

    @cached_property
    def vertices(self) -> FloatArray:
        """World coordinates, those of the input, shape (v, 3); nothing is to be added to them."""
        mesh = self._plain
        return read_only(mesh.vertices + mesh.origin if mesh.origin.any() else mesh.vertices)

    @property
    def faces(self) -> IntArray:
        """Rows of `vertices`, shape (f, 3), anticlockwise as seen from outside."""
        return read_only(self._plain.faces)

    @property
    def normals(self) -> FloatArray | None:
        """Unit normals of the vertices, shape (v, 3), where they were asked for."""
        return None if self._plain.normals is None else read_only(self._plain.normals)

    @property
    def colours(self) -> ByteArray | None:
        """Red, green, blue of the vertices as uint8, shape (v, 3), where the points have them."""
        return None if self._plain.colours is None else read_only(self._plain.colours)

    @property
    def attributes(self) -> Mapping[str, NDArray[Any]]:
        """Any other numbers of the vertices, shape (v,), by name."""
        columns = self._plain.attributes
        return MappingProxyType({name: read_only(column) for name, column in columns.items()})

    @property
    def origin(self) -> FloatArray:
        """A whole-numbered place near the mesh if it lies far from zero, else zeros, shape (3,).

        `vertices` have it in them: subtract it before they become float32.
        """
        return read_only(self._plain.origin)

    @property
    def volume(self) -> float:
        """What a watertight mesh encloses, in cubed units of the input; else NaN."""
        return signed_volume(self._plain) if self.is_watertight else float("nan")

    @cached_property
    def area(self) -> float:
        """Of all faces, in squared units of the input."""
        return surface_area(self._plain)

    @property
    def is_watertight(self) -> bool:
        """Whether it is closed and manifold."""
        return self._topology.watertight

    @cached_property
    def bounds(self) -> FloatArray:
        """Least and greatest coordinates, shape (2, 3); NaN without vertices."""
        if not len(self._plain.vertices):
            return read_only(np.full((2, 3), np.nan))
        return read_only(np.array(bound_points(self._plain.vertices)) + self._plain.origin)

    @property
    def facts(self) -> Mapping[str, Any]:
        """What the job that made it found and decided, as ``--json`` prints; else nothing."""
        return MappingProxyType(dict(self._job.facts) if self._job else {})

    @cached_property
    def _topology(self) -> Topology:
        return check_mesh(self._plain)

    def __repr__(self) -> str:
        kind = "watertight" if self.is_watertight else "not watertight"
        low, high = self.bounds
        sides = " x ".join(f"{side:.4g}" for side in high - low)
        return (
            f"Mesh({len(self._plain.vertices):,} vertices, {len(self._plain.faces):,} faces, "
            f"{kind}, {sides})"
        )

    def simplify(self, faces: int | None = None, tolerance: float | None = None) -> Mesh:
        """Return it with fewer faces; it stops at whichever comes first.

        Parameters
        ----------
        faces : int, optional
            No fewer faces than that, but for one.
        tolerance : float, optional
            How far the surface may move, in units of the input.

        Raises
        ------
        UsageError
            Neither is given, or one is out of its range.
        """
        from hpcapp.simplification.mesh import simplify_mesh
        from hpcapp.simplification.target import Target

        target = Target(faces, tolerance)
        if not target.is_something:
            raise UsageError("simplify has no target", "give faces or tolerance")
        return wrap_mesh(simplify_mesh(self._plain, target), crs=self._crs, up=self._up)

    def mend(
        self,
        *,
        fill_holes: float | str | None = None,
        pieces: int | None = None,
        smallest: float | None = None,
        box: Sequence[float] | None = None,
        around: Sequence[float] | None = None,
        polygon: str | PathLike[str] | None = None,
    ) -> Mesh:
        """Return it with holes filled, then cut, then without some of its pieces.

        Parameters
        ----------
        fill_holes : float or str, optional
            Holes up to this size are filled: the diagonal of the box around a border, in units of
            the input, or in median edges as "10s".
        pieces : int, optional
            So many connected pieces are kept, the largest ones.
        smallest : float, optional
            Only pieces with this area or more are kept, in squared units of the input.
        box : sequence of float, optional
            x, y and z of two corners: what lies between them is kept.
        around : sequence of float, optional
            x, y, z of a place and a distance from it, likewise.
        polygon : path-like or str, optional
            A file of polygons (GeoJSON, WKT or a shapefile), or WKT itself: what lies above and
            below them is kept.

        Raises
        ------
        UsageError
            Nothing is given, or something is out of its range.
        InputError
            It has no faces, or nothing where it is cut.
        """
        from hpcapp.applications.surface.boundary.lengths import require_length
        from hpcapp.geometry.pieces import PieceChoice
        from hpcapp.mending.mend import Mending, mend_mesh

        largest = None if fill_holes is None else require_length("fill_holes", str(fill_holes))
        asked = Mending(largest, PieceChoice(pieces, smallest), make_crop(box, around, polygon))
        asked.choice.check()
        if not asked.is_something:
            raise UsageError("nothing to mend", "give fill_holes, pieces or a part")
        mended = mend_mesh(self._plain, asked, self._crs.height_scale)
        return wrap_mesh(mended, crs=self._crs, up=self._up)

    def for_print(
        self,
        *,
        scale: str | None = None,
        height: float | str | None = None,
        unit: str | None = None,
        wall: float | str = 2.0,
        pieces: int = 1,
        up: str | None = None,
    ) -> Mesh:
        """Return a print of it: closed, on a flat base, in millimetres from zero with z up.

        Parameters
        ----------
        scale : str, optional
            As "1:10"; by default the largest round one up to 1:1 that fits into 250 mm, or what is
            100 mm along its longest side where no unit is known.
        height : float or str, optional
            In millimetres, or as "12cm".
        unit : str, optional
            Of its coordinates: mm, cm, m, km, in, ft; by default as its file says.
        wall : float or str
            How thick an open surface is made, and least what is below a terrain.
        pieces : int
            So many connected pieces are kept, the largest ones.
        up : {"z", "y", "x", "-z", "-y", "-x"}, optional
            The axis that points up; by default z, or y of what stands on a flat base there.

        Raises
        ------
        UsageError
            Something is out of its range, or a scale is asked for and no unit is known.
        InputError
            It is no surface.
        MissingLibraryError
            manifold3d is not installed.
        """
        from hpcapp.printing.request import make_printing

        asked = make_printing(scale, height, unit, wall)
        check_range("pieces", pieces, 1)
        from hpcapp.printing.prepare import PRINTED, make_print

        known = self._up if up is None else check_up(up)
        made = make_print(self._plain, self._crs, asked, known, pieces)[0]
        return wrap_mesh(made, crs=PRINTED, up="z")

    def save(
        self,
        path: str | PathLike[str],
        size: int | str | None = None,
        *,
        attributes: str = "auto",
        origin: str | Sequence[float] = "auto",
        up: str | None = None,
    ) -> None:
        """Write it to a file, with the bytes that ``hpcapp reconstruct -o`` writes.

        The unit and the coordinate reference system of the files that it was made from go along;
        so do those of a PLY that it was read from.

        Parameters
        ----------
        path : str or PathLike
            The suffix chooses the format: .ply, .obj, .glb, .vtp, .3mf, .off, .stl, or the folders
            .tiles and .3dtiles. What a format does not hold is logged as a warning.
        size : int or str, optional
            Bytes that the file has at most, as 20_000_000 or "20MB": what is written is simplified
            to fit. A .glb leaves out `attributes` first, of which viewers show none.
        attributes : str
            What of its vertices is written: ``auto`` (all), ``none``, or names as "normals,c".
        origin : str or sequence of float, shape (3,)
            What is subtracted from the coordinates: ``auto`` subtracts `origin` in .glb, .obj, .stl
            and .3mf, which are read in single precision; ``keep`` nothing; or a place. It is
            written beside the file, and `read_mesh` adds it.
        up : {"z", "y", "x", "-z", "-y", "-x"}, optional
            The axis that points up, for formats that say so; by default z, or y of what stands on a
            flat base there.

        Raises
        ------
        UsageError
            No mesh that was tried fits the size, the output is a folder, or what is given is none.
        OutputError
            The suffix is unknown, or the file cannot be written.
        """
        formats.check_writable(path)
        choice = parse_attributes(attributes)
        plain = choice.select_of_mesh(self._plain, "the mesh")
        words = origin if isinstance(origin, str) else ",".join(map(repr, map(float, origin)))
        placement = Placement(parse_origin(words), self._up if up is None else check_up(up))
        if size is not None:
            from hpcapp.simplification.size import fit_mesh, read_size

            most, suffix, named = read_size(size, path), Path(path).suffix, choice.named
            plain = fit_mesh(plain, most, suffix, self._crs, placement, named)
        formats.write_mesh(path, replace(as_stream(plain), crs=self._crs), placement)

    def report(self, path: str | PathLike[str]) -> None:
        """Write the page of ``hpcapp reconstruct --report``: the mesh, its points, all decisions.

        Parameters
        ----------
        path : str or PathLike
            A file .html, which works offline. Of a mesh that no job of this process has made, it
            shows the mesh alone.

        Raises
        ------
        UsageError, OutputError
            The path is no page, or cannot be written; or the points were larger than `max_memory`.
        """
        page = Path(path)
        check_files([*PAGE.list_written(page)])
        if self._job is None:
            write_page(page, self._page(MOST_FACES))
        else:
            self._job.write_page(page, self._plain)

    def picture(
        self,
        path: str | PathLike[str],
        *,
        eye: tuple[float, float] | None = None,
        size: int = 800,
        up: str | None = None,
    ) -> None:
        """Draw it into a PNG file.

        Parameters
        ----------
        eye : tuple of float, optional
            Azimuth and elevation of the viewer, in degrees.
        size : int
            Pixels along a side.
        up : {"z", "y", "x", "-z", "-y", "-x"}, optional
            The axis that points up; by default z, or y of what stands on a flat base there.
        """
        from hpcapp.pages.picture import write_picture

        check_files([*PICTURE.list_written(path)])
        write_picture(Path(path), self._plain, eye, size, self._choose_up(up), self._crs.unit)

    def show(self, points: PointCloud | None = None, *, open_browser: bool = True) -> Path:
        """Open a page with the mesh in a browser, and return its path in the temporary folder.

        Parameters
        ----------
        points : PointCloud, optional
            Shown beside it.
        open_browser : bool
            Whether to open the page, or to write it only.
        """
        beside = None
        if points is not None:
            beside = PointCloud(
                points.positions + (points.origin - self._plain.origin), colours=points.colours
            )
        path = Path(tempfile.mkdtemp(prefix="hpcapp-view-")) / "mesh.html"
        write_page(path, self._page(MOST_FACES, beside))
        return show_page(path, is_opened=open_browser)

    def to_trimesh(self) -> Any:
        """Return a copy as ``trimesh.Trimesh``, with colours, normals and attributes.

        Raises
        ------
        MissingLibraryError
            trimesh is not installed.
        """
        from hpcapp.api.conversion import to_trimesh

        return to_trimesh(self)

    def to_open3d(self) -> Any:
        """Return a copy as ``open3d.geometry.TriangleMesh``, with colours and normals.

        Raises
        ------
        MissingLibraryError
            open3d is not installed.
        """
        from hpcapp.api.conversion import to_open3d

        return to_open3d(self)

    def to_pyvista(self) -> Any:
        """Return a copy as ``pyvista.PolyData``, with colours, normals and attributes.

        Raises
        ------
        MissingLibraryError
            pyvista is not installed.
        """
        from hpcapp.api.conversion import to_pyvista

        return to_pyvista(self)

    def _repr_html_(self) -> str:
        """Return a page in a frame, for notebooks."""
        return frame_page(self._page(IN_NOTEBOOK, is_small=True))

    def _repr_png_(self) -> bytes:
        """Return a picture, for notebooks where no page can be shown."""
        return draw_small(self._plain, self._choose_up())

    def _choose_up(self, asked: str | None = None) -> str:
        """Return the axis that points up."""
        known = self._up if asked is None else check_up(asked)
        return choose_up(replace(as_stream(self._plain), crs=self._crs), known)

    def _page(self, most: int, points: PointCloud | None = None, *, is_small: bool = False) -> str:
        unit = self._crs.unit or ""
        return build_mesh_page(self._plain, most, self._choose_up(), unit, points, is_small)


def wrap_mesh(
    mesh: plain.Mesh,
    job: JobRecord | None = None,
    topology: Topology | None = None,
    crs: Crs = UNKNOWN,
    up: str | None = None,
) -> Mesh:
    """Return a mesh of the pipeline for users; its topology, where it is known already."""
    wrapped = Mesh.__new__(Mesh)
    wrapped._plain, wrapped._job, wrapped._crs, wrapped._up = mesh, job, crs, up
    if topology is not None:
        wrapped.__dict__["_topology"] = topology
    return wrapped


def unwrap_mesh(mesh: Mesh) -> plain.Mesh:
    """Return a user's mesh for the pipeline, in its local frame."""
    return mesh._plain


def read_mesh(path: str | PathLike[str]) -> Mesh:
    """Read a triangle mesh: .ply, .obj, .off, .stl, .glb, .vtp; polygons become triangle fans.

    Parameters
    ----------
    path : str or PathLike
        The suffix, in any case, chooses the format.

    Raises
    ------
    InputError
        The file cannot be opened, is damaged or holds no faces.
    UsageError
        The suffix is unknown.
    """
    return wrap_mesh(
        formats.read_mesh(path), crs=formats.find_mesh_crs(path), up=formats.find_mesh_up(path)
    )
