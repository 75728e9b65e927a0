"""A page: one file of HTML with all that it shows and the program that shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template

from hpcapp.io.staging import replacing
from hpcapp.pages.arrays import pack_text
from hpcapp.pages.scene import Scene, pack_scene
from hpcapp.wording import say_value
from hpccomponent.dataclass import dataclass

# In the order in which they are loaded: each may import those before it, by its name.
_MODULES = (
    ("three", "three/three.module.min.js"),
    ("three/addons/controls/OrbitControls.js", "three/OrbitControls.js"),
    ("hpcapp/viewer.js", "viewer.js"),
    ("hpcapp/numbers.js", "numbers.js"),
    ("hpcapp/colours.js", "colours.js"),
    ("hpcapp/measuring.js", "measuring.js"),
    ("hpcapp/page.js", "page.js"),
)


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page beside the mesh; `body` is HTML."""

    title: str
    body: str


def build_page(
    title: str,
    summary: str,
    scene: Scene,
    sections: Sequence[Section] = (),
    *,
    is_small: bool = False,
) -> str:
    """Return a page as HTML; the same scene and sections give the same text.

    Parameters
    ----------
    title, summary : str
        Its heading, and the line below.
    sections : sequence of Section
        Below the controls.
    is_small : bool
        Whether it is shown within another page.
    """
    description, colourings, arrays = pack_scene(scene)
    modules = "\n".join(
        f'<script type="application/gzip" data-module="{name}">{pack_text(_read(file))}</script>'
        for name, file in _MODULES
    )
    return Template(_read("page.html")).substitute(
        version=escape(version("hpcapp")),
        layout="small" if is_small else "large",
        title=escape(title),
        summary=escape(summary),
        style=_read("design.css") + _read("page.css"),
        controls=_make_controls(scene, colourings),
        sections="\n".join(f"<h2>{escape(part.title)}</h2>\n{part.body}" for part in sections),
        licence=escape(_read("three/LICENSE")),
        scene=description,
        arrays=arrays,
        modules=modules,
        boot=_read("boot.js"),
    )


def write_page(path: Path, page: str) -> None:
    """Write a page, which appears whole or not at all; `OutputError` where it cannot be written."""
    with replacing(path) as file:
        file.write(page.encode(errors="backslashreplace"))  # a name that is not UTF-8


def make_table(rows: Mapping[str, object]) -> str:
    """Return names and values as an HTML table; numbers stand below each other."""
    lines = []
    for name, value in rows.items():
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        kind = ' class="number"' if is_number else ""
        lines.append(f"<tr><th>{escape(name)}</th><td{kind}>{escape(say_value(value))}</td></tr>")
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def make_list(texts: Sequence[str], kind: str = "", first_marker: int | None = None) -> str:
    """Return lines as an HTML list.

    Parameters
    ----------
    kind : str
        The class of its items.
    first_marker : int, optional
        The items are the scene's markers, from this one on, and lead there.
    """
    items = []
    for number, text in enumerate(texts):
        link = (
            "" if first_marker is None else f' data-marker="{first_marker + number}" tabindex="0"'
        )
        items.append(f'<li class="{kind}"{link}>{escape(text)}</li>')
    tag = "ul" if first_marker is None else "ol"
    return f"<{tag}>\n" + "\n".join(items) + f"\n</{tag}>"


def _read(name: str) -> str:
    return files("hpcapp.pages").joinpath("static", *name.split("/")).read_text(encoding="utf-8")


def _make_controls(scene: Scene, colourings: Sequence[tuple[str, str]]) -> str:
    """Return the controls that mean something for a scene."""
    rows = [("Show", _make_boxes(scene))]
    if colourings:
        options = "".join(
            f'<option value="{escape(name)}">{escape(label)}</option>' for name, label in colourings
        )
        rows.append(("Colour", f'<select id="colouring">{options}</select>'))
        rows.append(("", '<div id="legend"></div>'))
        rows.append((
            '<span id="scale-name" hidden>Scale</span>',
            '<span class="row" id="scale-row" hidden><input type="range" id="scale-end" min="0" '
            'max="1" step="0.005" aria-label="end of the scale">'
            '<button id="scale-reset" type="button">reset</button></span>',
        ))  # fmt: skip
    if scene.mesh is not None:
        backs = _box("backs", '<i id="backs-tint"></i>back faces', True)
        rows.append(("Draw", _box("wireframe", "wireframe") + _box("flat", "facets") + backs))
    axes = "".join(f'<option value="{axis}">{axis}</option>' for axis in "xyz")
    rows.append((
        "Clip",
        f'<select id="clip-axis"><option value="">off</option>{axes}</select>'
        '<input type="range" id="clip-at" min="0" max="1" step="0.002" value="0.5" '
        f'aria-label="where">{_box("clip-flip", "other side")}',
    ))  # fmt: skip
    if scene.points is not None:
        rows.append((
            "Point size",
            '<input type="range" id="point-size" min="1" max="8" step="0.5" value="2">',
        ))  # fmt: skip
    ups = "".join(
        f'<option value="{sign}{axis}"{" selected" if sign + axis == scene.up else ""}>'
        f"{axis} {way}</option>"
        for sign, way in (("", "up"), ("-", "down"))
        for axis in "zyx"
    )
    rows.append((
        "View",
        f'<select id="up" aria-label="axis that points up">{ups}</select>'
        '<button id="reset" type="button">whole</button>'
        '<button id="picture" type="button">save picture</button>',
    ))  # fmt: skip
    rows.append((
        "Measure",
        '<button id="measure" type="button">two places</button><output id="measured"></output>',
    ))  # fmt: skip
    lines = [f'<span>{name}</span><div class="row">{body}</div>' for name, body in rows]
    return '<div class="controls">\n' + "\n".join(lines) + "\n</div>"


def _make_boxes(scene: Scene) -> str:
    """Return a box for each part of a scene that can be hidden."""
    boxes = [] if scene.mesh is None else [_box("show-mesh", "mesh", True)]
    if scene.points is not None:
        boxes.append(_box("show-points", "points", scene.mesh is None))
    if scene.markers:
        boxes.append(_box("show-markers", "warnings", True))
    if scene.tint is not None:
        boxes.append(_box("tint", "guesswork", True))
    return " ".join(boxes)


def _box(name: str, label: str, is_checked: bool = False) -> str:
    checked = " checked" if is_checked else ""
    return f'<label><input type="checkbox" id="{name}"{checked}> {label}</label>'
