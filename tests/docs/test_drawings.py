"""The drawings of the docs: current, well formed, and no words beyond their boxes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

DOCS = Path(__file__).parents[2] / "docs"
SVG = "{http://www.w3.org/2000/svg}"
CHARACTER = 6.6  # pixels: the mean of the widest of the fonts, at their size


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("drawn")
    subprocess.run([sys.executable, str(DOCS / "drawings.py"), str(folder)], check=True)
    return {path.name: path.read_text(encoding="utf-8") for path in folder.iterdir()}


def test_what_the_docs_show_is_what_the_tables_draw(drawn: dict[str, str]) -> None:
    shown = {
        path.name: path.read_text(encoding="utf-8")
        for path in (DOCS / "figures").glob("figure_*_*.svg")
    }
    assert shown == drawn, "run: python docs/drawings.py"


def test_every_drawing_has_its_fellow_and_is_shown(drawn: dict[str, str]) -> None:
    page = (DOCS / "explanation" / "architecture.md").read_text(encoding="utf-8")
    kinds = {name.split("_")[1] for name in drawn}
    assert {f"figure_{kind}_{whose}.svg" for kind in kinds for whose in ("paper", "ours")} == set(
        drawn
    )
    assert all(f"figures/{name}" in page for name in drawn)


def test_words_stay_within_the_box_that_they_are_in(drawn: dict[str, str]) -> None:
    for name, text in drawn.items():
        for x, width, words in texts_in_boxes(ElementTree.fromstring(text)):  # noqa: S314 - our own
            assert len(words) * CHARACTER <= width, f"{name}: {words!r} at {x} is too long"


def texts_in_boxes(drawing: ElementTree.Element) -> Iterator[tuple[float, float, str]]:
    """Yield the place and the words of each centred text, with the width of the innermost box."""
    boxes = [
        tuple(float(box.attrib[side]) for side in ("x", "y", "width", "height"))
        for box in drawing.iter(SVG + "rect")
    ]
    for text in drawing.iter(SVG + "text"):
        x, y = float(text.attrib["x"]), float(text.attrib["y"])
        if text.attrib["text-anchor"] == "middle":
            around = [
                width
                for left, top, width, height in boxes
                if left <= x <= left + width and top <= y <= top + height
            ]
            yield x, min(around), text.text or ""
