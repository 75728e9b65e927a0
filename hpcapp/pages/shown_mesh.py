"""The mesh that users get from Python: it shows itself, in a notebook or in a browser."""

from __future__ import annotations

import logging
import tempfile
import webbrowser
from dataclasses import dataclass, fields
from html import escape
from os import PathLike
from pathlib import Path

from hpcapp.applications.surface.types import mesh as plain
from hpcapp.applications.surface.types.points import PointCloud
from hpcapp.io import formats
from hpcapp.pages.page import build_page, write_page
from hpcapp.pages.scene import Scene, fields_of
from hpcapp.pages.thin import MOST_FACES, thin_mesh

__all__ = ["Mesh", "read_mesh", "show_page"]

log = logging.getLogger("hpcapp")

_IN_NOTEBOOK = 200_000  # faces: the notebook keeps the page in its file
_HEIGHT = 480  # pixels of a frame


@dataclass(frozen=True, slots=True, eq=False)
class Mesh(plain.Mesh):
    """A triangle mesh in a local frame, with a page of itself.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
        In length units of the input, relative to `origin`.
    faces : ndarray of int64, shape (f, 3)
        Vertex indices, anticlockwise as seen from outside.
    origin : ndarray of float64, shape (3,)
        To be added to the vertices for the input's own coordinates.
    normals : ndarray of float64, shape (v, 3), or None
    colours : ndarray of uint8, shape (v, 3), or None
    attributes : dict of str to ndarray, shape (v,)

    Examples
    --------
    >>> import numpy as np
    >>> mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    >>> mesh._repr_html_()[:7]
    '<iframe'
    """

    @classmethod
    def of(cls, mesh: plain.Mesh) -> Mesh:
        """Return a mesh with the same arrays that shows itself."""
        return cls(*(getattr(mesh, field.name) for field in fields(plain.Mesh)))

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
                points.positions + (points.origin - self.origin), colours=points.colours
            )
        path = Path(tempfile.mkdtemp(prefix="hpcapp-view-")) / "mesh.html"
        write_page(path, self._page(MOST_FACES, beside))
        return show_page(path, is_opened=open_browser)

    def _repr_html_(self) -> str:
        """Return a page in a frame, for notebooks."""
        page = escape(self._page(_IN_NOTEBOOK, is_small=True))
        return (
            f'<iframe srcdoc="{page}" style="width: 100%; height: {_HEIGHT}px; border: 0" '
            'title="mesh"></iframe>'
        )

    def _page(self, most: int, points: PointCloud | None = None, *, is_small: bool = False) -> str:
        thin = thin_mesh(self, most)
        summary = f"{len(self.vertices):,} vertices, {len(self.faces):,} faces"
        if thin is not self:
            summary += f"; a copy with {len(thin.faces):,} faces is shown"
        scene = Scene(thin, fields_of(thin), points)
        return build_page("Mesh", summary, scene, is_small=is_small)


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
    return Mesh.of(formats.read_mesh(path))


def show_page(path: Path, *, is_opened: bool) -> Path:
    """Open a page in a browser, if one is wanted at all."""
    if is_opened and not webbrowser.open(path.resolve().as_uri()):
        log.warning("warning: no browser was found: open %s by hand", path)
    return path
