"""Polygons that say which part of a scan is asked for: GeoJSON, WKT and shapefiles."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.extras import how_to_install
from hpcapp.geometry.prism import load_shapely
from hpcapp.io.points.point_source import translated
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import InputError, MissingLibraryError
from hpccomponent.foreign_json import decode
from hpccomponent.ranges import FARTHEST, is_place

OUTLINE_SUFFIXES = (".geojson", ".json", ".wkt", ".txt", ".shp")
_WKT = re.compile(r"\s*+(SRID=\d+;\s*+)?(MULTI)?POLYGON", re.IGNORECASE)
_EXPORT = "export the polygons again, as GeoJSON"


def read_outline(given: str) -> str:
    """Return all polygons of a file as one text in WKT, in which they are valid and flat.

    Parameters
    ----------
    given : str
        A file, or WKT itself.

    Raises
    ------
    InputError
        It cannot be read, holds no polygon, or one that crosses itself.
    MissingLibraryError
        shapely is not installed, or pyshp, which a shapefile needs.
    """
    shapely = load_shapely("polygons")
    path, name = Path(given), given
    if _WKT.match(given):
        shapes, name = [_read_text(given, "the polygon", shapely)], "the polygon"
    elif path.suffix.lower() not in OUTLINE_SUFFIXES:
        raise InputError(
            f"{name_option('polygon', given)}: neither WKT nor a file of a known kind",
            f"give one of {', '.join(OUTLINE_SUFFIXES)}, or 'POLYGON ((0 0, 9 0, 9 9, 0 0))'",
        )
    else:
        with translated(path):
            shapes = [shapely.force_2d(shape) for shape in _read_file(path, shapely)]
    return _unite(shapes, name, shapely)


def _read_file(path: Path, shapely: Any) -> Iterable[Any]:
    """Return the shapes of a file, some of which may be no polygons."""
    suffix = path.suffix.lower()
    if suffix == ".shp":
        return [_make_shape(shape, path, shapely) for shape in _read_shapefile(path)]
    text = path.read_bytes().decode("utf-8-sig", "replace")
    if suffix in (".wkt", ".txt"):
        return [_read_text(line, str(path), shapely) for line in _split_lines(text)]
    try:
        found: object = decode(text, dict[str, Any])
    except ValueError as error:
        raise InputError(f"{path}: no GeoJSON: {error}", _EXPORT) from None
    return [_make_shape(shape, path, shapely) for shape in _list_shapes(found)]


def _split_lines(text: str) -> list[str]:
    """Return the texts of a file of WKT: one a line, unless one goes on for several."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines if all(map(_WKT.match, lines)) else [text]


def _read_text(text: str, name: str, shapely: Any) -> Any:
    try:
        return shapely.from_wkt(text.partition(";")[2] if ";" in text else text)
    except shapely.errors.GEOSException as error:
        raise InputError(f"{name}: no WKT: {str(error).splitlines()[0]}", _EXPORT) from None


def _list_shapes(found: object) -> list[Any]:
    """Return the shapes of GeoJSON, out of features and collections of them."""
    if isinstance(found, list):
        return [shape for part in found for shape in _list_shapes(part)]
    if not isinstance(found, dict):
        return []
    for name in ("features", "geometries", "geometry"):
        if name in found:
            return _list_shapes(found[name])
    return [found]


def _make_shape(found: Any, path: Path, shapely: Any) -> Any:
    from shapely.geometry import shape

    try:
        return shape(found)
    except (
        shapely.errors.ShapelyError, AttributeError, IndexError, KeyError, TypeError, ValueError,
    ) as error:  # fmt: skip
        said = str(error).splitlines()[0] if str(error) else "it is damaged"
        raise InputError(f"{path}: a shape cannot be read: {said}", _EXPORT) from None


def _read_shapefile(path: Path) -> list[Any]:
    try:
        import shapefile
    except ModuleNotFoundError:
        raise MissingLibraryError(
            f"{path}: shapefiles need the package pyshp", how_to_install("gis")
        ) from None
    with path.open("rb") as file:
        try:
            with shapefile.Reader(shp=file) as reader:
                return [shape.__geo_interface__ for shape in reader.iterShapes()]
        except Exception as error:
            raise InputError(f"{path}: no shapefile: {error}", _EXPORT) from None


def _unite(shapes: Iterable[Any], name: str, shapely: Any) -> str:
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
