"""Polygons and lines that a user has drawn: GeoJSON, WKT and shapefiles."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from hpcapp.extras import load_library
from hpcapp.geometry.regions.prism import load_shapely
from hpcapp.io.points.point_source import translated
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError
from hpccomponent.foreign_json import convert, decode
from hpccomponent.ranges import FARTHEST, is_place

OUTLINE_SUFFIXES = (".geojson", ".json", ".wkt", ".txt", ".shp")
_CURVES = r"CIRCULARSTRING|COMPOUNDCURVE|CURVEPOLYGON|MULTICURVE|MULTISURFACE"
_CURVED = re.compile(rf"\b({_CURVES})\b", re.IGNORECASE)
_WKT = re.compile(
    rf"\s*+(SRID=\d++;\s*+)?({_CURVES}|(MULTI)?(POLYGON|LINESTRING|POINT)|GEOMETRYCOLLECTION)"
    r"\s*+(ZM|Z|M)?\s*+(\(|EMPTY)",
    re.IGNORECASE,
)
_DEEPEST = 32  # parentheses within each other: a collection of polygons has four
_EXPORT = "export the shapes again, as GeoJSON"
_HEADER, _RECORD = 100, 8  # bytes of a shapefile, and in front of each shape
_NAMES = ("name", "label", "id", "fid")
"""Properties of GeoJSON that a shape is called by; the first that is there counts."""
_LONGEST = 60  # characters of a name

_Position = Annotated[list[float], Meta(min_length=2)]
_Rings = list[list[_Position]]
_COORDINATES: dict[object, Any] = {
    "Polygon": _Rings, "MultiPolygon": list[_Rings],
    "LineString": list[_Position], "MultiLineString": _Rings,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Kind:
    """What is looked for: types of GeoJSON, and types of shapes: flat, with z, and with m."""

    word: str
    types: tuple[str, str]
    numbers: tuple[int, ...]
    advice: str
    example: str


_POLYGONS = _Kind(
    "polygon", ("Polygon", "MultiPolygon"), (5, 15, 25), "draw one round what is meant",
    "POLYGON ((0 0, 9 0, 9 9, 0 0))",
)  # fmt: skip
_LINES = _Kind(
    "line", ("LineString", "MultiLineString"), (3, 13, 23), "draw one along what is to be cut",
    "LINESTRING (0 0, 9 0, 9 9)",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A polygon or a line of shapely, valid and flat, and the name that its file has for it, or "".

    A polygon may be several with one name.
    """

    name: str
    shape: Any


def read_outline(given: str) -> str:
    """Return all polygons of a file, or of WKT, as one text in WKT: valid and flat.

    Raise InputError where it cannot be read, holds no polygon, or one that crosses itself,
    UsageError where that is true of WKT itself, and MissingLibraryError without shapely, or pyshp
    for a shapefile.
    """
    shapely, shapes = load_shapely(), [one.shape for one in read_polygons(given)]
    text: str = shapely.to_wkt(shapely.union_all(shapes), rounding_precision=-1)
    return text


def read_polygons(given: str) -> list[Drawn]:
    """Return the polygons of a file, or of WKT, one by one; errors are those of `read_outline`."""
    return _read_drawn(given, "polygon", _POLYGONS)


def read_lines(given: str) -> list[Drawn]:
    """Return the lines of a file, or of WKT, one by one; errors are those of `read_outline`."""
    shapely, drawn = load_shapely(), _read_drawn(given, "along", _LINES)
    return [Drawn(one.name, part) for one in drawn for part in shapely.get_parts(one.shape)]


def _read_drawn(given: str, option: str, kind: _Kind) -> list[Drawn]:
    shapely = load_shapely()
    path, name = Path(given), name_option(option)
    if path.suffix.lower() in OUTLINE_SUFFIXES:
        with translated(path):
            return _check(_read_file(path, kind, shapely), given, kind, shapely)
    if not _WKT.match(given):
        raise InputError(
            f"{name_option(option, given)}: neither WKT nor a file of a known kind",
            f"give one of {', '.join(OUTLINE_SUFFIXES)}, or '{kind.example}'",
        )
    try:
        return _check([Drawn("", _read_text(given, name, shapely))], name, kind, shapely)
    except InputError as error:
        raise UsageError(error.problem, error.advice) from None


def _read_file(path: Path, kind: _Kind, shapely: Any) -> Iterable[Drawn]:
    """Return the shapes of a file, some of which may be of another kind."""
    suffix = path.suffix.lower()
    content = path.read_bytes()
    if suffix == ".shp":
        shapes = _read_shapefile(content, path, kind)
        return [Drawn("", _make_shape(shape, path, shapely)) for shape in shapes]
    text = content.decode("utf-8-sig", "replace")
    if suffix in (".wkt", ".txt"):
        return [Drawn("", _read_text(line, str(path), shapely)) for line in _split_lines(text)]
    try:
        found: object = decode(text, dict[str, Any])
    except ValueError as error:
        raise InputError(f"{path}: no GeoJSON: {error}", _EXPORT) from None
    return [
        Drawn(name, _make_shape(shape, path, shapely)) for name, shape in _list_shapes(found, kind)
    ]


def _split_lines(text: str) -> list[str]:
    """Return the texts of a file of WKT: one a line, unless one goes on for several."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines if all(map(_WKT.match, lines)) else [text]


def _read_text(text: str, name: str, shapely: Any) -> Any:
    """Return the shape that WKT says; GEOS has no bound of its own for what is nested."""
    if curve := _CURVED.search(text):
        raise InputError(
            f"{name}: it has curves ({curve[0].upper()}), which are not read",
            "make them straight: in QGIS by 'Segmentize by maximum distance'",
        )
    steps = np.frombuffer(text.encode("ascii", "replace"), np.uint8)
    depth = np.cumsum((steps == ord("(")).astype(np.int64) - (steps == ord(")")))
    if depth.max(initial=0) > _DEEPEST:
        raise InputError(f"{name}: no WKT: it is nested more than {_DEEPEST} deep", _EXPORT)
    if 0 in steps:
        raise InputError(f"{name}: no WKT: it has a zero byte, where GEOS would stop", _EXPORT)
    try:
        return shapely.force_2d(shapely.from_wkt(re.sub(r"^\s*SRID=\d+;", "", text)))
    except (shapely.errors.ShapelyError, NotImplementedError, ValueError) as error:
        raise InputError(f"{name}: no WKT: {str(error).splitlines()[0]}", _EXPORT) from None


def _list_shapes(found: object, kind: _Kind) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield shapes of GeoJSON with their names, out of features and collections of them."""
    waiting = [("", found)]
    while waiting:
        name, part = waiting.pop()
        if isinstance(part, list):
            waiting += [(name, one) for one in reversed(part)]
        elif isinstance(part, dict):
            inside = [part[key] for key in ("features", "geometries", "geometry") if key in part]
            waiting += [(_find_name(part) or name, one) for one in inside[:1]]
            if not inside and part.get("type") in kind.types:
                yield name, part


def _find_name(feature: dict[str, Any]) -> str:
    """Return what a feature is called; its text on one line."""
    stated = feature.get("properties")
    known = (
        {str(key).lower(): value for key, value in stated.items()}
        if isinstance(stated, dict)
        else {}
    )
    values = [known.get(key) for key in _NAMES] + [feature.get("id")]
    texts = [str(one) for one in values if isinstance(one, str | int | float)]
    return "".join(filter(str.isprintable, texts[0]))[:_LONGEST].strip() if texts else ""


def _make_shape(found: dict[str, Any], path: Path, shapely: Any) -> Any:
    from shapely.geometry import shape

    kind = found["type"]
    try:
        numbers = convert(found.get("coordinates"), _COORDINATES[kind])
        return shapely.force_2d(shape({"type": kind, "coordinates": numbers}))
    except (shapely.errors.ShapelyError, IndexError, TypeError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else "it is damaged"
        raise InputError(f"{path}: a shape cannot be read: {said}", _EXPORT) from None


def _read_shapefile(content: bytes, path: Path, kind: _Kind) -> list[dict[str, Any]]:
    shapefile = load_library("shapefile", f"{path}: shapefiles need the package pyshp", "gis")
    try:
        _check_shapefile(content, kind)
        with shapefile.Reader(shp=BytesIO(content)) as reader:
            found = [shape.__geo_interface__ for shape in reader.iterShapes()]
    except Exception as error:
        raise InputError(f"{path}: no shapefile: {error}", _EXPORT) from None
    return [one for one in found if one["type"] in kind.types]


def _check_shapefile(content: bytes, kind: _Kind) -> None:
    """Refuse a file that pyshp would read in parts without a word; ValueError says why.

    "ESRI Shapefile Technical Description", July 1998.
    """
    stated, stored = 2 * int.from_bytes(content[24:28], "big"), content[32:36]
    if stated != len(content) or stated < _HEADER:
        raise ValueError(f"it says it has {stated} bytes, and has {len(content)}")
    if (number := int.from_bytes(stored, "little")) not in kind.numbers:
        raise ValueError(f"it holds shapes of type {number}, which are no {kind.word}s")
    at = _HEADER
    while at < stated:
        size = 2 * int.from_bytes(content[at + 4 : at + _RECORD], "big")
        shape = content[at + _RECORD : at + _RECORD + size]
        at += _RECORD + size
        if at > stated or size < len(stored):
            raise ValueError("a shape of it is cut")
        if shape == bytes(4):  # one without coordinates
            continue
        parts, points = np.frombuffer(shape, "<i4", 2, 36).tolist()
        least, column = 44 + 4 * parts + 16 * points, 16 + 8 * points  # of z, and of m
        if shape[:4] != stored or size not in (least, least + column, least + 2 * column):
            raise ValueError("a shape of it has another length or type than it says")
        starts = np.frombuffer(shape, "<i4", parts, 44)
        if not parts or starts[0] != 0 or (np.diff(starts, append=points) < 1).any():
            raise ValueError("the rings of a shape do not follow each other")


def _check(shapes: Iterable[Drawn], name: str, kind: _Kind, shapely: Any) -> list[Drawn]:
    """Return the shapes of a kind that hold something, checked."""
    found = [one for one in shapes if one.shape.geom_type in kind.types and not one.shape.is_empty]
    if not found:
        raise InputError(f"{name}: no {kind.word} in it", kind.advice)
    for one in found:
        coordinates = shapely.get_coordinates(one.shape)
        if not is_place(*np.abs(coordinates).max(axis=0)):
            raise InputError(f"{name}: a coordinate is no number up to {FARTHEST:.0e}", _EXPORT)
        if not shapely.is_valid(one.shape):
            raise InputError(
                f"{name}: a {kind.word} is not valid: {shapely.is_valid_reason(one.shape)}",
                "mend it where it was drawn ('fix geometries')",
            )
    return found
