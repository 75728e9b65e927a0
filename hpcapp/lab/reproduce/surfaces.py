"""Figure 6: the surface at three resolutions, by the paper's method and by the default one."""

from __future__ import annotations

from hpcapp.applications.compare.metrics import measure_mesh
from hpcapp.applications.compare.truth import PointTruth
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.methods.method import MethodSettings, Resources
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.pipeline import make_surface
from hpcapp.backends.selection import open_executor
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.lab.reproduce.finding import Finding
from hpcapp.lab.reproduce.panels import PANEL, Picture, draw_panels
from hpcapp.lab.reproduce.readings import STEP_1
from hpcapp.lab.reproduce.subject import Subject, arrange_for
from hpcapp.pages.render import render_mesh
from hpcapp.progress import Progress, StageClock

#: The paper's resolutions.
GRIDS = (24, 64, 256)
_SAMPLES = 20_000
_SENTENCE = (
    "No combination of the paper's rules gives the surface of its Figure 6 here: its blend jumps "
    "at the faces of the boxes, and eigenvector fits of flat patches change sides; a finer grid "
    "shows the walls better and does not remove them. "
)
_COLUMNS = (
    "method",
    "grid",
    "watertight",
    "components",
    "genus",
    "points to mesh",
    "mesh to points",
    "normals, degrees",
)


def mesh_by_default(subject: Subject, grid: int) -> Mesh:
    """Return the mesh by the default method, with `grid` cells along the longest side."""
    return _mesh(subject.points, Hierarchical(), grid)


def _mesh(points: PointCloud, method: MethodSettings, grid: int) -> Mesh:
    with open_executor("serial") as opened:
        clock = StageClock(Progress())
        cloud = arrange_for(method, points)
        strategy = method.open(grid, Resources())
        return make_surface(cloud, strategy, opened.workforce, clock).surface.mesh()


def make_figure_6(subject: Subject, up: str, clock: StageClock) -> tuple[Finding, Picture]:
    """Reconstruct at each resolution by both methods; the picture has shape (h, w, 3).

    The paper's method is measured with its step 1, too, which is not drawn.
    """
    points = subject.points
    ways: tuple[tuple[str, MethodSettings, PointCloud], ...] = (
        ("the paper's", Paper(), points),
        ("the default", Hierarchical(), points),
        ("the paper's with step 1", Paper(), subject.apply_step_1()),
    )
    truth = PointTruth(points)
    rows: list[tuple[str, ...]] = []
    panels: list[tuple[str, Picture]] = []
    for name, method, cloud in ways:
        for grid in GRIDS:
            with clock.stage(f"{name}, grid {grid}"):
                mesh = _mesh(cloud, method, grid)
                rows.append((name, str(grid), *_measure(mesh, truth)))
                if cloud is points:
                    label = f"({'abcdef'[len(panels)]}) {name}, {grid}\N{SUPERSCRIPT THREE}"
                    panels.append((label, render_mesh(mesh, size=PANEL, up=up)))
    finding = Finding(
        f"Figure 6: the surface of {subject.name} at three resolutions",
        _COLUMNS,
        tuple(rows),
        f"{_SENTENCE}{STEP_1}.",
        "Above by the paper's method as printed, below by the default one, at "
        + ", ".join(map(str, GRIDS))
        + " cells along the longest side. Distances are means in per cent of the diagonal; backs "
        "of faces are red.",
    )
    return finding, draw_panels(panels, columns=len(GRIDS))


def _measure(mesh: Mesh, truth: PointTruth) -> tuple[str, ...]:
    measures = measure_mesh(mesh, truth, _SAMPLES)
    topology = measures.topology
    return (
        "yes" if topology.watertight else "no",
        str(topology.components),
        str(topology.genus) if topology.watertight else "-",
        f"{measures.completeness:.3f} %",
        f"{measures.accuracy:.3f} %",
        f"{measures.normal_deg:.1f}",
    )
