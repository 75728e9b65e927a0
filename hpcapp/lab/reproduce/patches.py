"""Figure 4: the patches by the most points that each may hold, beside the paper's four numbers."""

from __future__ import annotations

from dataclasses import replace
from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hpcapp.applications.surface.paper.kdtree import TreePatches
from hpcapp.geometry.mesh import Mesh
from hpcapp.lab.reproduce.finding import Finding
from hpcapp.lab.reproduce.panels import PANEL, Picture, colour_patches, draw_panels
from hpcapp.lab.reproduce.readings import OTHER_CLOUD, STEP_1, RuleReading
from hpcapp.lab.reproduce.subject import Subject
from hpcapp.lab.reproduce.surfaces import mesh_by_default
from hpcapp.pages.render import render_mesh
from hpcapp.progress import StageClock

_GRID = 160  # of the mesh that shows the patches
#: The paper's patches by the most points of each.
PAPER_COUNTS = {20_000: 4, 10_000: 115, 1_000: 237, 100: 2_727}
_CONES = {
    "paper": "as printed, n.m > 0.1",
    "complement": "complement, n.m > 0.9",
    "none": "points only",
}
#: Nearer than this is near: the paper's Figure 2 is met within as much.
_NEAR = 0.08
_ON_BUNNY = (
    "No reading gives 4 or 115. With the normal cone the bunny has 240 patches or more, whatever "
    "the limit on points; without it, halving boxes gives 3 patches of at most 20,000 points and 7 "
    "of at most 10,000. "
)


def make_figure_4(subject: Subject, up: str, clock: StageClock) -> tuple[Finding, Picture]:
    """Cut a cloud by the normal cone and by the most points; the picture has shape (h, w, 3)."""
    with clock.stage("mesh"):
        mesh = mesh_by_default(subject, _GRID)
        _, nearest = cKDTree(subject.points.positions).query(
            mesh.vertices + (mesh.origin - subject.points.origin)
        )
    prepared = subject.apply_step_1()
    rows, panels = [], []
    with clock.stage("cut and draw"):
        for number, (limit, paper) in enumerate(PAPER_COUNTS.items()):
            readings = {cone: RuleReading(cone, max_points=limit) for cone in _CONES}
            cuts = {cone: reading.cut(subject.points) for cone, reading in readings.items()}
            best = min(cuts, key=lambda cone: abs(log(len(cuts[cone]) / paper)))
            count = len(cuts[best])
            is_near = abs(count / paper - 1.0) < _NEAR
            rows.append((
                f"{limit:,}",
                f"{paper:,}",
                *(f"{len(patches):,}" for patches in cuts.values()),
                ("" if is_near else "none is near: ")
                + f"{count:,}, {_CONES[best]} ({count / paper - 1.0:+.0%})",
                f"{len(readings[best].cut(prepared)):,}",
            ))  # fmt: skip
            picture = render_mesh(_colour(mesh, cuts[best], nearest), size=PANEL, up=up)
            panels.append((f"({'abcd'[number]}) {count:,} patches; paper: {paper:,}", picture))
            clock.progress.advance(number + 1, len(PAPER_COUNTS))
    finding = Finding(
        f"Figure 4: patches of {subject.name} by their most points",
        (
            "most points",
            "in the paper",
            *_CONES.values(),
            f"nearest reading, near if within {_NEAR:.0%}",
            "that with step 1",
        ),
        tuple(rows),
        (_ON_BUNNY if subject.is_papers else OTHER_CLOUD) + f"{STEP_1}.",
        "Each patch in a colour of its own, by the reading with the nearest number: at most "
        + ", ".join(f"{limit:,}" for limit in PAPER_COUNTS)
        + " points.",
    )
    return finding, draw_panels(panels, columns=2)


def _colour(mesh: Mesh, patches: TreePatches, nearest: NDArray[np.int64]) -> Mesh:
    """Return the mesh with each vertex in the colour of the patch of the point nearest to it."""
    owner = np.empty(len(patches.order), np.int64)
    owner[patches.order] = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
    return replace(mesh, colours=colour_patches(len(patches))[owner[nearest]])
