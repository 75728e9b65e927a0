"""The drawings of the paper's architecture and of ours: python docs/drawings.py [FOLDER].

Each drawing is a table of frames, boxes and arrows, on a card of 360 pixels' width; one
colour means one role, in the paper's drawings and in ours. How points are cut is drawn from a run
on ``examples/knot.ply``. They are written as SVG that follows the reader's light or dark scheme.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Literal

import numpy as np

from hpcapp.applications.surface.field.pyramid import build_pyramid
from hpcapp.applications.surface.paper.kdtree import partition_by_count
from hpcapp.geometry.lattice import unpack_keys
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import read_points

WIDTH = 360
LINE = 17  # between lines of text
FIGURES = Path(__file__).parent / "figures"
SCAN = Path(__file__).parents[1] / "examples" / "knot.ply"
PANEL, STEPS = 100.0, 6  # side of a panel, and how many there are
DOTS = 900  # points that are drawn

Role = Literal["master", "worker", "loader", "data", "frame"]

STYLE = """
text { font: 12.5px system-ui, "Segoe UI", "DejaVu Sans", sans-serif; fill: #1c2530 }
.title { font-weight: 600; font-size: 14px } .note { fill: #566270 }
.card { fill: #ffffff; stroke: #d5dae1 } .frame { fill: #f3f5f8; stroke: #a9b3bf }
.master { fill: #dbe9fb; stroke: #3f76bf } .worker { fill: #dcf2e0; stroke: #3b8d52 }
.loader { fill: #fbeccd; stroke: #b07d1a } .data { fill: #ece6f6; stroke: #7a5cae }
.arrow { stroke: #566270; stroke-width: 1.5; fill: none } .head { fill: #566270 }
.dots { stroke: #7a5cae; stroke-width: 1.5; stroke-linecap: round }
.cell { fill: none; stroke: #3f76bf; stroke-width: .7 }
@media (prefers-color-scheme: dark) {
text { fill: #e7ecf2 } .note { fill: #a7b2bf }
.card { fill: #16191d; stroke: #39414b } .frame { fill: #1f242a; stroke: #5a6572 }
.master { fill: #1c3557; stroke: #6fa3e6 } .worker { fill: #1b3d26; stroke: #66bb7d }
.loader { fill: #453512; stroke: #d8a441 } .data { fill: #342a4a; stroke: #a78bda }
.arrow { stroke: #a7b2bf } .head { fill: #a7b2bf }
.dots { stroke: #a78bda } .cell { stroke: #6fa3e6 }
}
"""


@dataclass(frozen=True, slots=True)
class Box:
    """A part, with its words in the middle; a frame has them at its top."""

    role: Role
    x: float
    y: float
    width: float
    height: float
    lines: tuple[str, ...]

    def draw(self) -> str:
        """Return the box as SVG."""
        left, top = self.x + 0.5 * self.width, self.y + 0.5 * self.height
        first = top - 0.5 * LINE * (len(self.lines) - 1) + 4.5
        if self.role == "frame":
            first = self.y + LINE
        return (
            f'<rect class="{self.role}" x="{self.x:g}" y="{self.y:g}" width="{self.width:g}" '
            f'height="{self.height:g}" rx="6"/>\n'
        ) + "".join(
            _write(left, first + LINE * i, line, "note" if self.role == "frame" else "")
            for i, line in enumerate(self.lines)
        )


@dataclass(frozen=True, slots=True)
class Arrow:
    """A straight arrow, with words beside its middle."""

    x: float
    y: float
    to_x: float
    to_y: float
    words: str = ""
    both: bool = False

    def draw(self) -> str:
        """Return the arrow as SVG."""
        start = ' marker-start="url(#head)"' if self.both else ""
        line = (
            f'<line class="arrow" x1="{self.x:g}" y1="{self.y:g}" x2="{self.to_x:g}" '
            f'y2="{self.to_y:g}" marker-end="url(#head)"{start}/>\n'
        )
        if not self.words:
            return line
        x, y = 0.5 * (self.x + self.to_x) + 8, 0.5 * (self.y + self.to_y) + 4
        return line + _write(x, y, self.words, "note", "start")


@dataclass(frozen=True, slots=True)
class Note:
    """Words about a point, in no box."""

    x: float
    y: float
    words: str

    def draw(self) -> str:
        """Return the words as SVG."""
        return _write(self.x, self.y, self.words, "note")


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """Points and the boxes that they are cut into, as seen along z.

    Parameters
    ----------
    points : ndarray of float64, shape (n, 2)
        In shares of the panel, from its lower left corner, as are the boxes.
    low, high : ndarray of float64, shape (b, 2)
        Corners of the boxes.
    """

    x: float
    y: float
    points: FloatArray
    low: FloatArray
    high: FloatArray
    words: str

    def draw(self) -> str:
        """Return the panel as SVG."""
        place = np.array([self.x, self.y + PANEL])
        dots = place + [PANEL, -PANEL] * self.points
        path = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in dots)
        first, sizes = place + [PANEL, -PANEL] * self.low, PANEL * (self.high - self.low)
        cells = "".join(
            f"M{x:.1f} {y:.1f}h{w:.1f}v{-h:.1f}h{-w:.1f}z"
            for x, y, w, h in np.hstack([first, sizes])
        )
        words = _write(self.x + 0.5 * PANEL, self.y + PANEL + LINE, self.words, "note")
        return f'<path class="dots" d="{path}"/>\n<path class="cell" d="{cells}"/>\n{words}'


Part = Box | Arrow | Note | Cut


@dataclass(frozen=True, slots=True)
class Drawing:
    """What is drawn on one card."""

    title: str
    height: float
    parts: tuple[Part, ...]

    def draw(self) -> str:
        """Return the whole SVG."""
        size = f'width="{WIDTH}" height="{self.height:g}" viewBox="0 0 {WIDTH} {self.height:g}"'
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">\n'
            f"<title>{escape(self.title)}</title>\n<style>{STYLE}</style>\n"
            '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
            'markerHeight="7" orient="auto-start-reverse"><path class="head" d="M0 0L8 4L0 8z"/>'
            "</marker></defs>\n"
            f'<rect class="card" x="0.5" y="0.5" width="{WIDTH - 1}" height="{self.height - 1:g}" '
            'rx="8"/>\n'
            + _write(0.5 * WIDTH, 24, self.title, "title")
            + "".join(part.draw() for part in self.parts)
            + "</svg>\n"
        )


def _write(x: float, y: float, words: str, kind: str = "", anchor: str = "middle") -> str:
    style = f' class="{kind}"' if kind else ""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}"{style}>{escape(words)}</text>\n'


def _stack(*steps: tuple[Role, str]) -> tuple[Part, ...]:
    """Return a column of boxes, each with an arrow to the next; lines are parted by ``|``."""
    parts: list[Part] = []
    y = 40.0
    for i, (role, words) in enumerate(steps):
        lines = tuple(words.split("|"))
        height = 14.0 + LINE * len(lines)
        parts.append(Box(role, 30, y, 300, height, lines))
        y += height
        if i + 1 < len(steps):
            parts.append(Arrow(180, y, 180, y + 20))
            y += 20
    return tuple(parts)


FLOW_PAPER = Drawing(
    "The paper: from points to a surface",
    428,
    _stack(
        ("data", "points with normals"),
        ("master", "1. denoise, resample"),
        ("master", "2. kd-tree: split boxes until the|normals of each lie in a cone"),
        ("worker", "3. fit one quadric to each box"),
        ("master", "4. blend: the quadric whose box|holds the node"),
        ("master", "5. marching cubes"),
        ("data", "surface"),
    ),
)
FLOW_OURS = Drawing(
    "Here: from points to a mesh",
    428,
    _stack(
        ("data", "any scan"),
        ("worker", "read, clean, orient, mend, measure"),
        ("master", "resolve the grid; partition into tiles;|fit coarse quadrics and the far field"),
        ("worker", "fit fine quadrics, blend them smoothly,|extract the tile's part of the mesh"),
        ("master", "close or cut; stitch parts by vertex ids"),
        ("master", "write, and check: closed, manifold"),
        ("data", "watertight mesh"),
    ),
)
WORK_PAPER = Drawing(
    "The paper: master and slaves",
    270,
    (
        Box("master", 60, 42, 240, 48, ("master process", "cuts; later blends and extracts")),
        Arrow(90, 90, 70, 166, both=True),
        Arrow(180, 90, 180, 166, both=True),
        Arrow(270, 90, 290, 166, both=True),
        Box("worker", 20, 166, 100, 48, ("slave 1", "1/k of patches")),
        Box("worker", 130, 166, 100, 48, ("slave 2", "1/k of patches")),
        Box("worker", 240, 166, 100, 48, ("slave k", "1/k of patches")),
        Note(180, 234, "points of patches out, quadrics back;"),
        Note(180, 251, "equal shares"),
    ),
)
WORK_OURS = Drawing(
    "Here: master and workers",
    270,
    (
        Box("master", 60, 42, 240, 48, ("master", "plans tiles; later stitches")),
        Arrow(90, 90, 70, 166, both=True),
        Arrow(180, 90, 180, 166, both=True),
        Arrow(270, 90, 290, 166, both=True),
        Box("worker", 20, 166, 100, 48, ("worker 1", "next tile")),
        Box("worker", 130, 166, 100, 48, ("worker 2", "next tile")),
        Box("worker", 240, 166, 100, 48, ("worker k", "next tile")),
        Note(180, 234, "tiles out, summaries of mesh parts back;"),
        Note(180, 251, "as workers get free; what is lost runs again"),
    ),
)


def _machine(x: float, title: str, loader: str, component: str, *within: str) -> tuple[Part, ...]:
    """Return a machine with its loader, and the component with what is `within`, from above."""
    parts: list[Part] = [
        Box("frame", x, 190, 155, 226, (title,)),
        Box("loader", x + 12, 218, 131, 32, (loader,)),
        Arrow(x + 77.5, 250, x + 77.5, 278, "starts"),
        Box("frame", x + 12, 278, 131, 126, (component,)),
        Box("worker", x + 24, 360 if within[1:] else 330, 107, 32, within[-1:]),
    ]
    if within[1:]:
        parts.append(Box("master", x + 24, 306, 107, 32, within[:1]))
        parts.append(Arrow(x + 77.5, 338, x + 77.5, 360, both=True))
    return tuple(parts)


_PAPER_MACHINE = ("Loader", "HPC Component", "slave")
_OUR_MACHINE = ("loader", "component", "session", "worker")
PARTS_PAPER = Drawing(
    "The paper: the parts",
    484,
    (
        Box("frame", 20, 40, 320, 96, ("VM 1: HPC App",)),
        Box("master", 35, 72, 130, 48, ("master process",)),
        Arrow(165, 96, 195, 96, both=True),
        Box("master", 195, 72, 130, 48, ("communicator",)),
        Arrow(225, 136, 120, 190, both=True),
        Arrow(260, 136, 260, 190, "messages", both=True),
        *_machine(20, "VM 1 as well", *_PAPER_MACHINE),
        *_machine(185, "VM 2, 3 and 4", *_PAPER_MACHINE),
        Box("frame", 20, 432, 320, 32, ()),
        Note(180, 453, "a private cloud: Eucalyptus"),
    ),
)
PARTS_OURS = Drawing(
    "Here: the parts",
    484,
    (
        Box("frame", 20, 40, 320, 96, ("head, or your own machine: hpcapp",)),
        Box("master", 35, 72, 130, 48, ("pipeline", "(the master)")),
        Arrow(165, 96, 195, 96, both=True),
        Box("master", 195, 72, 130, 48, ("communicator", "(scheduler)")),
        Arrow(225, 136, 120, 190, both=True),
        Arrow(260, 136, 260, 190, "CURVE", both=True),
        *_machine(20, "the head, if asked", *_OUR_MACHINE),
        *_machine(185, "every other machine", *_OUR_MACHINE),
        Box("loader", 20, 432, 320, 32, ("deploy: machines from a cluster file",)),
    ),
)


def _draw_cuts(title: str, cuts: list[tuple[FloatArray, FloatArray, str]]) -> Drawing:
    """Return a drawing of the knot, cut ever finer; boxes are in its coordinates."""
    positions, origin, side = _read_knot()
    dots = (positions.positions[:: len(positions) // DOTS, :2] - origin[:2]) / side
    panels = []
    for step, (low, high, words) in enumerate(cuts):
        corners: FloatArray = np.hstack([low[:, :2], high[:, :2]])
        corners = np.unique(corners.round(9), axis=0)
        row, column = divmod(step, 3)
        shares: FloatArray = (corners - np.tile(origin[:2], 2)) / side
        x, y = 20.0 + 110.0 * column, 40.0 + (PANEL + 30.0) * row
        panels.append(Cut(x, y, dots, shares[:, :2], shares[:, 2:], words))
    return Drawing(title, 40.0 + 2.0 * (PANEL + 30.0), tuple(panels))


def _read_knot() -> tuple[PointCloud, FloatArray, float]:
    """Return the points, and the lowest corner and the side of the cube around them."""
    cloud = read_points(SCAN)
    low, high = cloud.positions.min(axis=0), cloud.positions.max(axis=0)
    side = 1.001 * float((high - low).max())  # no point on the far sides
    return cloud, 0.5 * (low + high - side), side


def draw_kd_tree() -> Drawing:
    """Return the paper's Figure 3: boxes halved along their longest axes, the fullest first."""
    cloud, _, _ = _read_knot()
    cuts = []
    for count in (1, 2, 4, 8, 16, 64):
        patches = partition_by_count(cloud.positions, count)
        cuts.append(
            (patches.box_low, patches.box_high, "1 box" if count == 1 else f"{count} boxes")
        )
    return _draw_cuts("The paper: a kd-tree cuts boxes in halves", cuts)


def draw_pyramid() -> Drawing:
    """Return what is here in its place: the cells of a pyramid that hold points."""
    cloud, origin, side = _read_knot()
    pyramid = build_pyramid(cloud, origin, side / 2 ** (STEPS - 1), STEPS)
    cuts = []
    for depth in reversed(range(STEPS)):
        size = pyramid.cell_size * 2**depth
        low = origin + size * unpack_keys(pyramid.levels[depth].cells)
        cuts.append((low, low + size, f"{len(low)} cell" + "s" * (len(low) > 1)))
    return _draw_cuts("Here: a pyramid of cubes of one lattice", cuts)


#: What is written, by the name of its file.
DRAWINGS = {
    "figure_flow_paper.svg": FLOW_PAPER,
    "figure_flow_ours.svg": FLOW_OURS,
    "figure_work_paper.svg": WORK_PAPER,
    "figure_work_ours.svg": WORK_OURS,
    "figure_parts_paper.svg": PARTS_PAPER,
    "figure_parts_ours.svg": PARTS_OURS,
    "figure_cuts_paper.svg": draw_kd_tree(),
    "figure_cuts_ours.svg": draw_pyramid(),
}


def main(folder: Path) -> None:
    """Write all drawings into a folder."""
    for name, drawing in DRAWINGS.items():
        (folder / name).write_text(drawing.draw(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else FIGURES)
