"""Sections as DXF, SVG and GeoJSON."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from io import StringIO
from math import floor, log10
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from hpcapp.applications.section.sections import Outline, Section, Sections
from hpcapp.extras import load_library
from hpcapp.geometry.points import FloatArray
from hpcapp.io.geojson import write_lines
from hpcapp.io.staging import replacing
from hpccomponent.dataclass import dataclass

log = logging.getLogger("hpcapp")

_UNITS = {None: 0, "ft": 2, "mm": 4, "cm": 5, "m": 6, "km": 7, "US ft": 21}
"""Of DXF's header variable INSUNITS."""
_FORBIDDEN = re.compile(r'[<>/\\":;?*|=`,\s]+')  # in names of layers
_PAPER = 180.0  # mm that the larger side of the largest section may have, at most
_ROUND = (1.0, 2.0, 2.5, 5.0, 10.0)  # times a power of ten: scales that drawings have
_FRAMES = "frames"  # layer
_LETTER, _MARGIN = 3.0, 14.0  # mm: height of letters, and room around a section
_LINES = 6  # of the grid across the larger side, about
_DECIMALS = 3  # of a mm of paper
_STYLE = (
    "path{fill:none;stroke:#123;stroke-width:.25;stroke-linejoin:round}"
    ".closed{fill:#c8d4e6;fill-rule:evenodd}.grid{stroke:#ccc;stroke-width:.15}text{fill:#456}"
)


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One section of a flat drawing, over a grid, in a rectangle of (width, height).

    Its lower left is at a place; `low` is what of the section is there, multiples of the step.
    """

    section: Section
    low: FloatArray
    size: FloatArray
    place: FloatArray
    step: float

    def move(self, flat: FloatArray) -> FloatArray:
        """Return where places of the section, (n, 2), are in the drawing."""
        return flat - self.low + self.place


def load_ezdxf(path: Path) -> Any:
    """Return the library; MissingLibraryError where it is not installed."""
    return load_library("ezdxf", f"{path}: DXF needs the package ezdxf", "dxf")


def write_dxf(path: Path, sections: Sections, is_flat: bool) -> None:
    """Write polylines, a layer for each section: in place, or flat with the names below.

    Raise OutputError where the file cannot be written, MissingLibraryError without ezdxf.
    """
    drawing = load_ezdxf(path).new("R2010", units=_UNITS.get(sections.crs.unit, 0))
    space = drawing.modelspace()
    for layer in [*map(_name_layer, sections), *[_FRAMES] * is_flat]:
        if layer not in drawing.layers:
            drawing.layers.add(layer)
    if is_flat:
        for panel in lay_out(sections)[0]:
            _add_panel(space, panel)
    else:
        for section in sections:
            for one in section.outlines:
                _add_line(space.add_polyline3d, one, one.points, section)
    stream = StringIO()
    drawing.write(stream)
    with replacing(path) as file:
        file.write(stream.getvalue().encode(drawing.output_encoding, "dxfreplace"))


def _name_layer(section: Section) -> str:
    return _FORBIDDEN.sub(" ", section.name).strip() or "section"


def _add_line(
    add: Callable[..., object], outline: Outline, places: FloatArray, section: Section
) -> None:
    corners = places[: len(places) - outline.is_closed].tolist()
    add(corners, close=outline.is_closed, dxfattribs={"layer": _name_layer(section)})


def _add_panel(space: Any, panel: Panel) -> None:
    """Draw a section in a frame, and write below where its lower left is."""
    for one in panel.section.outlines:
        _add_line(space.add_lwpolyline, one, panel.move(one.flat), panel.section)
    (x, y), (right, top) = panel.place.tolist(), (panel.place + panel.size).tolist()
    letter, style = 0.25 * panel.step, {"layer": _FRAMES}
    corners = [(x, y), (right, y), (right, top), (x, top)]
    space.add_lwpolyline(corners, close=True, dxfattribs=style)
    left, bottom = (f"{along:.10g}" for along in panel.low.tolist())
    said = f"{_name_layer(panel.section)}: lower left {left}, {bottom}"
    text = space.add_text(said, height=letter, dxfattribs=style)
    text.set_placement((x, y - 2.0 * letter))


def write_geojson(path: Path, sections: Sections) -> None:
    """Write lines in place; those that are closed end where they start.

    Raise OutputError where the file cannot be written.
    """
    lines = [
        (
            {
                "section": section.name, "line": section.line or None, "station": section.station,
                "closed": one.is_closed, "length": one.length, "area": one.area,
            },
            one.points,
        )
        for section in sections for one in section.outlines
    ]  # fmt: skip
    if sections.crs.text is None:
        log.warning("%s: states no coordinate reference system: the input has none", path)
    write_lines(path, lines, sections.crs.text)


def write_svg(path: Path, sections: Sections) -> None:
    """Write a page with all sections at one round scale, each over a grid with its numbers.

    Raise OutputError where the file cannot be written.
    """
    panels, scale = lay_out(sections)
    said = f"{scale:g} {sections.crs.unit or ''}".rstrip()
    low = np.min([one.place for one in panels], axis=0)
    high = np.max([one.place + one.size for one in panels], axis=0)
    width, height = ((high - low) / scale + 2.0 * _MARGIN).tolist()
    page = Element("svg", {
        "xmlns": "http://www.w3.org/2000/svg", "width": f"{width:.2f}mm",
        "height": f"{height:.2f}mm", "viewBox": f"0 0 {width:.2f} {height:.2f}",
        "font-family": "sans-serif", "font-size": "2",
    })  # fmt: skip
    SubElement(page, "title").text = f"1 mm is {said}"
    SubElement(page, "style").text = _STYLE
    SubElement(page, "rect", {"width": "100%", "height": "100%", "fill": "#fff"})
    for panel in panels:
        _draw_panel(SubElement(page, "g"), panel, np.array([low[0], high[1]]), scale)
    with replacing(path) as file:
        file.write(tostring(page, encoding="utf-8"))
    log.info("%s: 1 mm on paper is %s", path, said)


def _draw_panel(group: Element, panel: Panel, corner: FloatArray, scale: float) -> None:
    """Draw one section: its name, a grid with numbers, and the outlines.

    The page has a scale, in lengths of the input a mm, and its upper left at a corner.
    """

    def place(flat: FloatArray) -> FloatArray:
        return (panel.move(flat) - corner) * (1.0, -1.0) / scale + _MARGIN

    ends = np.stack([panel.low, panel.low + panel.size])
    (left, bottom), (right, top) = place(ends).tolist()
    group.set("id", f"section-{panel.section.name}")
    _write(group, left, top - 2.0, panel.section.name, {"font-size": f"{_LETTER}"})
    step = panel.step
    for axis, (begin, end) in enumerate(ends.T.tolist()):
        for k in range(round(begin / step), round(end / step) + 1):
            at = place(np.full((1, 2), k * step))[0, axis]
            line = f"M{at:.2f} {bottom:.2f}V{top:.2f}", f"M{left:.2f} {at:.2f}H{right:.2f}"
            SubElement(group, "path", {"class": "grid", "d": line[axis]})
            if axis == 0:
                _write(group, at, bottom + 3.4, f"{k * step:.10g}", {"text-anchor": "middle"})
            else:
                _write(group, left - 1.0, at + 0.7, f"{k * step:.10g}", {"text-anchor": "end"})
    for kind, end in (("closed", "Z"), ("open", "")):
        lines = [
            place(one.flat).round(_DECIMALS).tolist()
            for one in panel.section.outlines
            if one.is_closed == (kind == "closed")
        ]
        drawn = ["M" + "L".join(f"{x:g} {y:g}" for x, y in line) + end for line in lines]
        if drawn:
            SubElement(group, "path", {"class": kind, "d": "".join(drawn)})


def _write(group: Element, x: float, y: float, text: str, style: dict[str, str]) -> None:
    SubElement(group, "text", {"x": f"{x:.2f}", "y": f"{y:.2f}", **style}).text = text


def lay_out(sections: Sections) -> tuple[list[Panel], float]:
    """Return the sections that have outlines, in rows from the top, about as wide as high.

    The scale comes with them: what a mm of paper is, a round number.
    """
    shown = [one for one in sections if one.outlines]
    flats = [np.concatenate([one.flat for one in section.outlines]) for section in shown]
    step = round_up(max(float(np.ptp(flat, axis=0).max()) for flat in flats) / _LINES)
    lows = [step * np.floor(flat.min(axis=0) / step) for flat in flats]
    highs = [step * np.ceil(flat.max(axis=0) / step) for flat in flats]
    sizes = np.maximum(np.subtract(highs, lows), step)  # (sections, 2)
    scale = round_up(float(sizes.max()) / _PAPER)
    gap = 2.0 * _MARGIN * scale
    wide, high = (sizes.max(axis=0) + gap).tolist()
    columns = max(round((len(shown) * high / wide) ** 0.5), 1)
    panels, bottom = [], 0.0
    for k, (section, low, size) in enumerate(zip(shown, lows, sizes, strict=True)):
        if k % columns == 0:
            bottom -= float(sizes[k : k + columns, 1].max()) + gap
        panels.append(Panel(section, low, size, np.array([k % columns * wide, bottom]), step))
    return panels, scale


def round_up(width: float) -> float:
    """Return the least 1, 2, 2.5 or 5 times a power of ten that is as wide."""
    power = 10.0 ** floor(log10(width)) if width > 0.0 else 1.0
    return next(power * one for one in _ROUND if power * one >= width * (1.0 - 1e-9))
