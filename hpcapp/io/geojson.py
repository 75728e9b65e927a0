"""Lines as GeoJSON."""

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

    A member ``crs`` names the coordinate reference system as GDAL reads it: by EPSG's code where
    the text is ``EPSG:`` and one, or else as it is. Raise OutputError where the file cannot be
    written.
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
    if crs is not None:
        code = parse_epsg(crs)
        name = crs if code is None else f"urn:ogc:def:crs:EPSG::{code}"
        collection["crs"] = {"type": "name", "properties": {"name": name}}
    with replacing(path) as file:
        file.write(json.dumps(collection | {"features": features}).encode())
    return len(features)
