"""A page: one file of HTML with all that it shows and the program that shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from hpcapp.io.staging import replacing
from hpcapp.pages.arrays import pack_text
from hpcapp.pages.scene import Scene, pack_scene
from hpcapp.pages.templates import render
from hpccomponent.dataclass import dataclass

# In the order in which they are loaded: each may import those before it, by its name.
_MODULES = (
    ("three", "three/three.module.min.js"),
    ("three/addons/controls/OrbitControls.js", "three/OrbitControls.js"),
    ("hpcapp/viewer.js", "viewer.js"),
    ("hpcapp/numbers.js", "numbers.js"),
    ("hpcapp/colours.js", "colours.js"),
    ("hpcapp/taps.js", "taps.js"),
    ("hpcapp/saving.js", "saving.js"),
    ("hpcapp/frame.js", "frame.js"),
    ("hpcapp/measuring.js", "measuring.js"),
    ("hpcapp/cutting/kept.js", "cutting/kept.js"),
    ("hpcapp/cutting/handles.js", "cutting/handles.js"),
    ("hpcapp/cutting/box.js", "cutting/box.js"),
    ("hpcapp/cutting/polygon.js", "cutting/polygon.js"),
    ("hpcapp/cutting/pieces.js", "cutting/pieces.js"),
    ("hpcapp/cutting/cutting.js", "cutting/cutting.js"),
    ("hpcapp/page.js", "page.js"),
)


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page beside the mesh: a file of ``templates/``, and what it shows."""

    title: str
    template: str
    values: Mapping[str, object]


def build_page(
    title: str,
    summary: str,
    scene: Scene,
    sections: Sequence[Section] = (),
    *,
    is_small: bool = False,
) -> str:
    """Return a page as HTML; the same scene and sections give the same text.

    The summary is a line below the heading; sections are below the controls; a page is small where
    it is shown within another one.
    """
    description, arrays = pack_scene(scene)
    return render(
        "page.html",
        version=version("hpcapp"),
        is_small=is_small,
        title=title,
        summary=summary,
        style=_read("design.css") + _read("page.css"),
        scene=scene,
        sections=sections,
        licence=_read("three/LICENSE"),
        description=description,
        arrays=arrays,
        modules=[(name, pack_text(_read(file))) for name, file in _MODULES],
        boot=_read("boot.js"),
    )


def write_page(path: Path, page: str) -> None:
    """Write a page, which appears whole or not at all; `OutputError` where it cannot be written."""
    with replacing(path) as file:
        file.write(page.encode(errors="backslashreplace"))  # a name that is not UTF-8


def tabulate(
    title: str,
    rows: Mapping[str, object] | Sequence[Sequence[object]],
    head: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> Section:
    """Return a section with a table; numbers stand below each other.

    Rows are names, and what is said of each; with a head, columns are numbers. Notes are paragraphs
    below the table.
    """
    lines = list(rows.items()) if isinstance(rows, Mapping) else rows
    return Section(title, "table.html", {"rows": lines, "head": head, "notes": notes})


def _read(name: str) -> str:
    return files("hpcapp.pages").joinpath("static", *name.split("/")).read_text(encoding="utf-8")
