"""The page and the picture of a mesh that a user holds, and what it knows of its job."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.pages.page import build_page
from hpcapp.pages.scene import Scene, fields_of
from hpcapp.pages.templates import render
from hpcapp.pages.thin import thin_mesh
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.applications.surface.cloud.arranged import ArrangedCloud

IN_NOTEBOOK = 200_000
"""Faces: the notebook keeps the page in its file."""
_HEIGHT = 480  # pixels of a frame
_PICTURE = 360  # pixels along a side


@dataclass(frozen=True, slots=True, eq=False)
class JobRecord:
    """What a mesh knows of the job that made it.

    Parameters
    ----------
    source : str
        What was meshed, for titles.
    cloud : ArrangedCloud or None
        Its points, with normals; None where they lay in a folder, which is gone.
    facts : dict
        The report.
    """

    source: str
    cloud: ArrangedCloud | None
    facts: Mapping[str, Any] = field(default_factory=dict)

    def write_page(self, page: Path, mesh: Mesh) -> None:
        """Write the page of the job with the mesh that it has made.

        Raise UsageError where its points are gone.
        """
        if self.cloud is None:
            raise UsageError(
                "the points lay in a folder, which is gone with the job",
                "hpcapp reconstruct --report writes the page of such a job",
            )
        from hpcapp.applications.surface.steps.report_page import show_cloud, write_job_page

        spacing = float(self.facts.get("spacing") or 0.0)
        shown = show_cloud(as_stream(mesh), self.cloud, spacing)
        write_job_page(page, shown, self.facts, self.source)


def build_mesh_page(
    mesh: Mesh, most: int, up: str, unit: str, points: PointCloud | None, is_small: bool
) -> str:
    """Return the page of a mesh, of so many faces at most, with points beside it."""
    thin = thin_mesh(mesh, most)
    summary = f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces"
    if thin is not mesh:
        summary += f"; a copy with {len(thin.faces):,} faces is shown"
    scene = Scene(thin, fields_of(thin), points, up=up, unit=unit)
    return build_page("Mesh", summary, scene, is_small=is_small)


def frame_page(page: str) -> str:
    """Return a page in a frame, for notebooks."""
    return render("frame.html", page=page, height=_HEIGHT)


def draw_small(mesh: Mesh, up: str) -> bytes:
    """Return a small picture of a mesh as PNG, for notebooks."""
    from hpcapp.pages.picture import choose_eye
    from hpcapp.pages.png import encode_png
    from hpcapp.pages.render import render_mesh

    thin = thin_mesh(mesh, IN_NOTEBOOK)
    return encode_png(render_mesh(thin, *choose_eye(thin, up), _PICTURE, up))
