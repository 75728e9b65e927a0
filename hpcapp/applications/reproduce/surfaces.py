"""Figure 6: the mesh by the paper's method, beside that of the default method."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.compare.metrics import measure_mesh
from hpcapp.applications.compare.truth import PointTruth
from hpcapp.applications.reproduce.finding import Finding
from hpcapp.applications.reproduce.subject import Subject, arrange_for
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.method import MethodSettings, Resources
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.pipeline import reconstruct
from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.backends.selection import open_executor
from hpcapp.pages.render import render_mesh
from hpcapp.progress import Progress, StageClock

__all__ = ["make_figure_6", "mesh_by_default"]

_SAMPLES = 20_000
_SENTENCE = (
    "No combination of the paper's rules gives the surface of its Figure 6 here: its blend jumps "
    "at the faces of the boxes, and eigenvector fits of flat patches change sides."
)


def mesh_by_default(subject: Subject, grid: int) -> Mesh:
    """Return the mesh by the default method, with `grid` cells along the longest side."""
    return _mesh(subject, Hierarchical(), grid)


def _mesh(subject: Subject, method: MethodSettings, grid: int) -> Mesh:
    with open_executor("serial") as opened:
        clock = StageClock(Progress())
        cloud = arrange_for(method, subject.points)
        strategy = method.open(grid, Resources())
        return reconstruct(cloud, strategy, opened.workforce, clock).surface.mesh()


def make_figure_6(subject: Subject, grid: int, up: str) -> tuple[Finding, NDArray[np.uint8]]:
    """Reconstruct by the paper's method and by the default one; the picture has shape (h, w, 3)."""
    methods: tuple[tuple[str, MethodSettings], ...] = (
        ("the paper's, as printed", Paper()),
        ("the paper's, complement", Paper(cone="complement")),
        ("the default", Hierarchical()),
    )
    truth = PointTruth(subject.points)
    rows, panels = [], []
    for name, method in methods:
        mesh = _mesh(subject, method, grid)
        measures = measure_mesh(mesh, truth, _SAMPLES)
        topology = measures.topology
        rows.append((
            name,
            "yes" if topology.watertight else "no",
            str(topology.components),
            str(topology.genus) if topology.watertight else "-",
            f"{measures.completeness:.3f} %",
            f"{measures.accuracy:.3f} %",
            f"{measures.normal_deg:.1f}",
        ))  # fmt: skip
        panels.append(render_mesh(mesh, size=600, up=up))
    finding = Finding(
        f"Figure 6: the surface of {subject.name}, grid {grid}",
        (
            "method",
            "watertight",
            "components",
            "genus",
            "points to mesh",
            "mesh to points",
            "normals, degrees",
        ),
        tuple(rows),
        _SENTENCE,
        "From left to right: "
        + "; ".join(name for name, _ in methods)
        + ". Distances are means in per cent of the diagonal; backs of faces are red.",
    )
    return finding, np.concatenate(panels, axis=1)
