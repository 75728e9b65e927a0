"""Figure 2: a cloud, its patches, their quadrics, and the surface, in four panels.

All four are of the reading of the rule that comes nearest to the figure's 2,335 patches.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.paper.method import PaperMethod, PaperPartition
from hpcapp.applications.surface.paper.patch_quadrics import evaluate_quadrics, gradient_quadrics
from hpcapp.backends.selection import open_executor
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import (
    ByteArray,
    FloatArray,
    PointCloud,
)
from hpcapp.lab.reproduce.finding import Finding
from hpcapp.lab.reproduce.panels import PANEL, Picture, colour_patches, draw_panels
from hpcapp.lab.reproduce.readings import DELTA, OTHER_CLOUD, STEP_1, RuleReading
from hpcapp.lab.reproduce.subject import Subject
from hpcapp.pages.render import render_mesh
from hpcapp.progress import StageClock

_GRID = 128  # of the surface
_NEIGHBOURS = 4  # the last of them is a spacing away, where points lie evenly or at random
_NEWTON_STEPS = 5
_REACH = 0.25  # half sides of a box: how far a point is moved along each axis, at most
_SHOWN = RuleReading("complement", "tight")
_ROWS = (
    (RuleReading("paper"), "240 (Section V)"),
    (RuleReading("complement"), "-"),
    (_SHOWN, "2,335 (Figure 2)"),
)
_ON_BUNNY = (
    "The 240 patches of Section V are met by the rule as printed, on fewer points than its; the "
    "2,335 of Figure 2 only within 2 to 7 %, and only where normals agree above 1 - delta, as the "
    "paper's text has it and its formula has not. "
)


def make_figure_2(subject: Subject, up: str, clock: StageClock) -> tuple[Finding, Picture]:
    """Draw the four panels; the picture has shape (h, w, 3)."""
    with clock.stage("cut"):
        prepared = subject.apply_step_1()
        rows = tuple(
            (
                str(reading),
                f"{len(reading.cut(subject.points)):,}",
                f"{len(reading.cut(prepared)):,}",
                paper,
            )
            for reading, paper in _ROWS
        )
    panels = []
    for number, (label, mesh) in enumerate(_make_steps(subject.points, clock)):
        with clock.stage(f"draw panel {number + 1} of 4"):
            panels.append((label, render_mesh(mesh, size=PANEL, up=up)))
    finding = Finding(
        f"Figure 2: from points to a surface, {subject.name}",
        ("rule", "patches here", "with step 1", "in the paper"),
        rows,
        (_ON_BUNNY if subject.is_papers else OTHER_CLOUD) + f"{STEP_1}.",
        f"By the rule {_SHOWN}: (a) the input; (b) patches, each in a colour of its own; (c) their "
        f"quadrics, where their points lie; (d) the surface.",
    )
    return finding, draw_panels(panels, columns=2)


def _make_steps(points: PointCloud, clock: StageClock) -> Iterator[tuple[str, Mesh]]:
    """Yield the label and the mesh of each panel."""
    method = PaperMethod(DELTA, cone=_SHOWN.cone, root=_SHOWN.root, grid=_GRID)
    with open_executor("serial") as opened:
        partition = method.partition(MemoryCloud.as_they_are(points), opened.workforce)
        with clock.stage("fit"):
            quadrics = method.fit(partition, opened.workforce, clock.progress.advance)
        patches, grey = partition.patches, np.full((1, 3), 190, np.uint8)
        colours = colour_patches(len(patches))
        owner = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
        yield f"(a) input: {len(points):,} points", build_discs(partition.points, grey, 0.45)
        yield f"(b) {len(patches):,} patches", build_discs(partition.points, colours[owner])
        yield (
            f"(c) {len(patches):,} quadrics",
            (build_discs(project_points(partition, quadrics), colours[owner])),
        )
        surface = method.extract(partition, quadrics, opened.workforce, clock.progress.advance)
        yield f"(d) surface, grid {_GRID}", surface.mesh()


def build_discs(points: PointCloud, colours: ByteArray, size: float = 1.0) -> Mesh:
    """Return a square across each point's normal, seen from both sides, in colours (n or 1, 3).

    Normals have unit length; the size is half of a square's diagonal, in point spacings.
    """
    assert points.normals is not None  # noqa: S101 - a subject has them
    distances, _ = cKDTree(points.positions).query(points.positions, k=_NEIGHBOURS + 1)
    half = size * float(np.median(distances[:, -1]))
    # (n, 3) each: with the normal a right-angled frame
    first = np.cross(points.normals, np.eye(3)[np.abs(points.normals).argmin(axis=1)])
    first *= half / np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(points.normals, first)
    front = points.positions[:, None] + np.stack(
        [first, second, -first, -second], axis=1
    )  # (n, 4, 3): anticlockwise about the normal
    back = front[:, ::-1] - 0.2 * half * points.normals[:, None]
    vertices = np.concatenate([front.reshape(-1, 3), back.reshape(-1, 3)])
    corners = 4 * np.arange(len(vertices) // 4)[:, None, None]
    faces = (corners + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    shades = np.broadcast_to(colours, (len(points), 3))
    return Mesh(vertices, faces, points.origin, colours=np.tile(np.repeat(shades, 4, 0), (2, 1)))


def project_points(partition: PaperPartition, quadrics: FloatArray) -> PointCloud:
    """Return every point moved onto its patch's quadric (p, 10), with the quadric's normal there.

    Newton's steps go along the gradient, in patch coordinates; a point stays within its box's size,
    because the gradient vanishes between the two sheets of a fit that is nearly the square of a
    plane.
    """
    patches, points = partition.patches, partition.points
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
    scales, coefficients = patches.scales[owner, None], quadrics[owner]
    # (n, 3): the points in patch coordinates, and where they come to lie
    begin = (points.positions - patches.centers[owner]) / scales
    local = begin
    for _ in range(_NEWTON_STEPS):
        values = evaluate_quadrics(coefficients, local)[:, None]
        slopes = gradient_quadrics(coefficients, local)
        squares = np.maximum((slopes**2).sum(axis=1, keepdims=True), 1e-12)
        local = np.clip(local - values * slopes / squares, begin - _REACH, begin + _REACH)
    slopes = gradient_quadrics(coefficients, local)
    lengths = np.linalg.norm(slopes, axis=1, keepdims=True)
    normals = slopes / np.maximum(lengths, 1e-300)
    assert points.normals is not None  # noqa: S101 - a subject has them
    normals[lengths[:, 0] == 0.0] = points.normals[lengths[:, 0] == 0.0]
    return replace(points, positions=patches.centers[owner] + scales * local, normals=normals)
