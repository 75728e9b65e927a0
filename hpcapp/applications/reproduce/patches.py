"""Figures 2 and 4: the patches of the kd-tree, each in a colour of its own, and their number."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hpcapp.applications.reproduce.finding import Finding
from hpcapp.applications.reproduce.subject import Subject
from hpcapp.applications.reproduce.surfaces import mesh_by_default
from hpcapp.applications.surface.paper.kdtree import Patches, partition_by_rule
from hpcapp.applications.surface.paper.split_rule import SplitRule
from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.applications.surface.types.points import PointCloud
from hpcapp.pages.render import render_mesh

__all__ = ["make_figure_2", "make_figure_4"]

_GRID = 160  # of the mesh that shows the patches
_GOLDEN = 0.618033988749895  # turns of hue between neighbours of the tree: all of them differ
_PRINTED = "as printed, n.m > 0.1"
_COMPLEMENT = "complement, n.m > 0.9"
_BY_COUNT = "points only"
_NAMES = {"paper": _PRINTED, "complement": _COMPLEMENT, "none": _BY_COUNT}


@dataclass(frozen=True, slots=True)
class _Case:
    """One tree, and what the paper says of it; `paper` is empty where it says nothing."""

    cone: str
    root: str
    max_points: int | None = None
    paper: str = ""
    is_shown: bool = False

    def cut(self, points: PointCloud) -> Patches:
        assert points.normals is not None  # noqa: S101 - a subject has them
        rule = SplitRule(0.1, self.cone, self.max_points)
        return partition_by_rule(points.positions, points.normals, rule, self.root)

    def describe(self) -> str:
        limit = "" if self.max_points is None else f", at most {self.max_points:,} points"
        return f"{_NAMES[self.cone]}, root {self.root}{limit}"


_FIGURE_2 = (
    _Case("paper", "cube", paper="240 (Section V)", is_shown=True),
    _Case("complement", "cube", is_shown=True),
    _Case("complement", "tight", paper="2335 (Figure 2)", is_shown=True),
)
_FIGURE_4 = tuple(
    _Case(
        cone,
        "cube",
        limit,
        paper="2727 (Figure 4)" if (cone, limit) == ("complement", 100) else "",
        is_shown=(cone, limit) in (("none", 10_000), ("none", 1_000), ("complement", 100)),
    )
    for cone in ("paper", "complement", "none")
    for limit in (20_000, 10_000, 1_000, 100)
)
_OTHER_CLOUD = (
    "The paper's numbers are of the Stanford bunny with 35,947 points, so those of this cloud "
    "need not be near them."
)
_ON_BUNNY_2 = (
    "The 240 patches of Section V are met exactly by the rule as printed; the 2335 of Figure 2 "
    "only within 2 to 7 %, and only where normals agree above 1 - delta, as the paper's text has "
    "it and its formula has not."
)
_ON_BUNNY_4 = (
    "The 2727 patches of Figure 4 are met within 7 % where normals agree above 1 - delta; its 4 "
    "and 115 come from no combination of the rules, and the pictures nearest in kind are cut by "
    "the number of points alone."
)


def make_figure_2(subject: Subject, up: str) -> tuple[Finding, NDArray[np.uint8]]:
    """Cut a cloud by both readings of the normal cone; the picture has shape (h, w, 3)."""
    sentence = _ON_BUNNY_2 if subject.is_papers else _OTHER_CLOUD
    return _make(f"Figure 2: patches of {subject.name}", _FIGURE_2, sentence, subject, up)


def make_figure_4(subject: Subject, up: str) -> tuple[Finding, NDArray[np.uint8]]:
    """Cut a cloud by the normal cone and by the most points of a patch."""
    sentence = _ON_BUNNY_4 if subject.is_papers else _OTHER_CLOUD
    title = f"Figure 4: patches of {subject.name} by their most points"
    return _make(title, _FIGURE_4, sentence, subject, up)


def _make(
    title: str, cases: tuple[_Case, ...], sentence: str, subject: Subject, up: str
) -> tuple[Finding, NDArray[np.uint8]]:
    mesh = mesh_by_default(subject, _GRID)
    _, nearest = cKDTree(subject.points.positions).query(
        mesh.vertices + (mesh.origin - subject.points.origin)
    )
    rows, panels, shown = [], [], []
    for case in cases:
        patches = case.cut(subject.points)
        rows.append((case.describe(), str(len(patches)), case.paper or "-"))
        if case.is_shown:
            panels.append(render_mesh(_colour(mesh, patches, nearest), size=600, up=up))
            shown.append(f"{case.describe()} ({len(patches)} patches)")
    finding = Finding(
        title,
        ("rule", "patches here", "in the paper"),
        tuple(rows),
        sentence,
        "Each patch in a colour of its own, from left to right: " + "; ".join(shown) + ".",
    )
    return finding, np.concatenate(panels, axis=1)


def _colour(mesh: Mesh, patches: Patches, nearest: NDArray[np.int64]) -> Mesh:
    """Return the mesh with each vertex in the colour of the patch of the point nearest to it."""
    owner = np.empty(len(patches.order), np.int64)
    owner[patches.order] = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
    palette = np.array([
        colorsys.hsv_to_rgb(i * _GOLDEN % 1.0, (0.85, 0.55, 0.7)[i % 3], (0.95, 1.0, 0.7)[i % 3])
        for i in range(len(patches))
    ])  # fmt: skip
    colours = (255.0 * palette[owner[nearest]] + 0.5).astype(np.uint8)
    return replace(mesh, colours=colours)
