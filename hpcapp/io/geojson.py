"""Lines as GeoJSON, and the member that names a coordinate reference system."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from hpcapp.geometry.points import FloatArray
from hpcapp.io.crs import parse_epsg
from hpcapp.io.staging import replacing


def write_lines(
    path: Path, lines: Iterable[tuple[Mapping[str, object], FloatArray]], crs: str | None
) -> int:
    """Write lines, each with its properties and its points (n, 2) or (n, 3); return how many.

    The coordinate reference system is that of `name_crs`. Raise OutputError where the file cannot
    be written.
    """
    features = [
        {
            "type": "Feature",
            "properties": properties,
            "geometry": {"type": "LineString", "coordinates": points.tolist()},
        }
        for properties, points in lines
    ]
    collection: dict[str, object] = {"type": "FeatureCollection"}
    if member := name_crs(crs):
        collection["crs"] = member
    with replacing(path) as file:
        file.write(json.dumps(collection | {"features": features}).encode())
    return len(features)


def name_crs(crs: str | None) -> dict[str, object] | None:
    """Return the member ``crs`` of a collection, as GDAL reads it.

    It has EPSG's code where the text is ``EPSG:`` and one, or else the text.
    """
    if crs is None:
        return None
    code = parse_epsg(crs)
    name = crs if code is None else f"urn:ogc:def:crs:EPSG::{code}"
    return {"type": "name", "properties": {"name": name}}
