"""Polygons that say which part of a scan is asked for: GeoJSON, WKT and shapefiles."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from msgspec import Meta

from hpcapp.extras import load_library
from hpcapp.geometry.regions.prism import load_shapely
from hpcapp.io.points.point_source import translated
from hpccomponent.cli.option_names import name_option
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
_EXPORT = "export the polygons again, as GeoJSON"
_HEADER, _RECORD = 100, 8  # bytes of a shapefile, and in front of each shape
_POLYGONS = (5, 15, 25)  # types of shapes: flat, with z, and with m

_Object = dict[str, object]  # of GeoJSON
_Geometry: TypeAlias = Any  # of shapely, which has no stubs
_Position = Annotated[list[float], Meta(min_length=2)]
_Rings = list[list[_Position]]
_COORDINATES: dict[object, Any] = {"Polygon": _Rings, "MultiPolygon": list[_Rings]}


def read_outline(given: str) -> str:
    """Return all polygons of a file, or of WKT, as one text in WKT: valid and flat.

    Raise InputError where it cannot be read, holds no polygon, or one that crosses itself,
    UsageError where that is true of WKT itself, and MissingLibraryError without shapely, or pyshp
    for a shapefile.
    """
    load_shapely()  # before all else
    path, name = Path(given), name_option("polygon")
    if path.suffix.lower() in OUTLINE_SUFFIXES:
        with translated(path):
            return _unite(_read_file(path), given)
    if not _WKT.match(given):
        raise InputError(
            f"{name_option('polygon', given)}: neither WKT nor a file of a known kind",
            f"give one of {', '.join(OUTLINE_SUFFIXES)}, or 'POLYGON ((0 0, 9 0, 9 9, 0 0))'",
        )
    try:
        return _unite([_read_text(given, name)], name)
    except InputError as error:
        raise UsageError(error.problem, error.advice) from None


def _read_file(path: Path) -> Iterable[_Geometry]:
    """Return the shapes of a file, some of which may be no polygons."""
    suffix = path.suffix.lower()
    content = path.read_bytes()
    if suffix == ".shp":
        return [_make_shape(shape, path) for shape in _read_shapefile(content, path)]
    text = content.decode("utf-8-sig", "replace")
    if suffix in (".wkt", ".txt"):
        return [_read_text(line, str(path)) for line in _split_lines(text)]
    try:
        found: object = decode(text, dict[str, object])
    except ValueError as error:
        raise InputError(f"{path}: no GeoJSON: {error}", _EXPORT) from None
    return [_make_shape(shape, path) for shape in _list_shapes(found)]


def _split_lines(text: str) -> list[str]:
    """Return the texts of a file of WKT: one a line, unless one goes on for several."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines if all(map(_WKT.match, lines)) else [text]


def _read_text(text: str, name: str) -> _Geometry:
    """Return the shape that WKT says; GEOS has no bound of its own for what is nested."""
    shapely = load_shapely()
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


def _list_shapes(found: object) -> Iterator[_Object]:
    """Yield the polygons of GeoJSON, out of features and collections of them."""
    waiting = [found]
    while waiting:
        part = waiting.pop()
        if isinstance(part, list):
            waiting += reversed(part)
        elif isinstance(part, dict):
            inside = [part[key] for key in ("features", "geometries", "geometry") if key in part]
            waiting += inside[:1]
            if not inside and part.get("type") in ("Polygon", "MultiPolygon"):
                yield part


def _make_shape(found: _Object, path: Path) -> _Geometry:
    from shapely.geometry import shape

    shapely, kind = load_shapely(), found["type"]
    try:
        numbers = convert(found.get("coordinates"), _COORDINATES[kind])
        return shapely.force_2d(shape({"type": kind, "coordinates": numbers}))
    except (shapely.errors.ShapelyError, IndexError, TypeError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else "it is damaged"
        raise InputError(f"{path}: a shape cannot be read: {said}", _EXPORT) from None


def _read_shapefile(content: bytes, path: Path) -> list[_Object]:
    shapefile = load_library("shapefile", f"{path}: shapefiles need the package pyshp", "gis")
    try:
        _check_shapefile(content)
        with shapefile.Reader(shp=BytesIO(content)) as reader:
            found = [shape.__geo_interface__ for shape in reader.iterShapes()]
    except Exception as error:
        raise InputError(f"{path}: no shapefile: {error}", _EXPORT) from None
    return [one for one in found if one["type"] in _COORDINATES]


def _check_shapefile(content: bytes) -> None:
    """Refuse a file that pyshp would read in parts without a word; ValueError says why.

    "ESRI Shapefile Technical Description", July 1998.
    """
    stated, kind = 2 * int.from_bytes(content[24:28], "big"), content[32:36]
    if stated != len(content) or stated < _HEADER:
        raise ValueError(f"it says it has {stated} bytes, and has {len(content)}")
    if (number := int.from_bytes(kind, "little")) not in _POLYGONS:
        raise ValueError(f"it holds shapes of type {number}, which are no polygons")
    at = _HEADER
    while at < stated:
        size = 2 * int.from_bytes(content[at + 4 : at + _RECORD], "big")
        shape = content[at + _RECORD : at + _RECORD + size]
        at += _RECORD + size
        if at > stated or size < len(kind):
            raise ValueError("a shape of it is cut")
        if shape == bytes(4):  # one without coordinates
            continue
        parts, points = np.frombuffer(shape, "<i4", 2, 36).tolist()
        least, column = 44 + 4 * parts + 16 * points, 16 + 8 * points  # of z, and of m
        if shape[:4] != kind or size not in (least, least + column, least + 2 * column):
            raise ValueError("a shape of it has another length or type than it says")
        starts = np.frombuffer(shape, "<i4", parts, 44)
        if not parts or starts[0] != 0 or (np.diff(starts, append=points) < 1).any():
            raise ValueError("the rings of a shape do not follow each other")


def _unite(shapes: Iterable[_Geometry], name: str) -> str:
    shapely = load_shapely()
    polygons = [one for one in shapes if one.geom_type in ("Polygon", "MultiPolygon")]
    polygons = [one for one in polygons if not one.is_empty]
    if not polygons:
        raise InputError(f"{name}: no polygon in it", "draw one round what is to be kept")
    for one in polygons:
        coordinates = shapely.get_coordinates(one)
        if not is_place(*np.abs(coordinates).max(axis=0)):
            raise InputError(f"{name}: a coordinate is no number up to {FARTHEST:.0e}", _EXPORT)
        if not shapely.is_valid(one):
            raise InputError(
                f"{name}: a polygon is not valid: {shapely.is_valid_reason(one)}",
                "mend it where it was drawn ('fix geometries')",
            )
    text: str = shapely.to_wkt(shapely.union_all(polygons), rounding_precision=-1)
    return text
