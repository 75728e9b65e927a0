"""Write E57: one scan, with its colours, intensities and normals."""

from __future__ import annotations

import os
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.extras import load_library
from hpcapp.geometry.points import PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.frame import finite_bounds
from hpcapp.io.points.usable import drop_non_finite
from hpcapp.io.staging import replacing
from hpccomponent.errors import OutputError

_Foreign = Any  # of libE57, which has no stubs: the library, an image, and its nodes

_NORMALS_URI = "http://www.libe57.org/E57_NOR_surface_normals.txt"
_ROWS_AT_ONCE = 1 << 18


def write_e57(path: Path, cloud: PointCloud, crs: str | None = None) -> None:
    """Write a point cloud as an E57 file of one scan without a pose, taken to be in metres.

    It is in the input's frame. Of the attributes, ``intensity`` is kept; of reference systems, WKT.
    Raise OutputError where the file cannot be written, or no point has finite coordinates.
    """
    library = load_library("pye57.libe57", f"{path}: E57 needs the package pye57", "e57")
    cloud = drop_non_finite(cloud, path)
    with replacing(path) as file:
        target = Path(file.name)
        try:
            image = library.ImageFile(os.fsencode(target), "w")
            try:
                _write_image(library, image, cloud, crs)
            finally:
                image.close()
        except library.E57Exception as error:
            why = str(error).partition("\n")[0]
            raise OutputError(f"{path}: cannot be written: {why}", "check for room") from error


def _write_image(library: _Foreign, image: _Foreign, cloud: PointCloud, crs: str | None) -> None:
    image.extensionsAdd("", library.E57_V1_0_URI)
    if cloud.normals is not None:
        image.extensionsAdd("nor", _NORMALS_URI)
    columns = _find_columns(cloud)
    wkt = crs if crs and "[" in crs else ""
    scans = library.VectorNode(image, True)
    root = image.root()
    root.set("formatName", library.StringNode(image, "ASTM E57 3D Imaging Data File"))
    root.set("guid", _guid(library, image))
    root.set("versionMajor", library.IntegerNode(image, library.E57_FORMAT_MAJOR))
    root.set("versionMinor", library.IntegerNode(image, library.E57_FORMAT_MINOR))
    root.set("coordinateMetadata", library.StringNode(image, wkt))
    root.set("data3D", scans)
    root.set("images2D", library.VectorNode(image, True))

    scan = library.StructureNode(image)
    scan.set("guid", _guid(library, image))
    scan.set("name", library.StringNode(image, "points"))
    for name, limits in _find_limits(cloud, columns).items():
        structure = library.StructureNode(image)
        for limit, value in limits.items():
            structure.set(limit, _number(library, image, value))
        scan.set(name, structure)
    prototype = library.StructureNode(image)
    for name, values in columns.items():
        prototype.set(name, _field(library, image, values))
    points = library.CompressedVectorNode(image, prototype, library.VectorNode(image, True))
    scan.set("points", points)
    scans.append(scan)
    _write_columns(library, image, points, columns, len(cloud))


def _find_columns(cloud: PointCloud) -> dict[str, Numbers]:
    """Return what is written, by the names of the format, as arrays or views of the cloud."""
    columns: dict[str, Numbers] = {
        f"cartesian{axis}": cloud.positions[:, i] + cloud.origin[i] for i, axis in enumerate("XYZ")
    }
    if "intensity" in cloud.attributes:
        columns["intensity"] = cloud.attributes["intensity"].astype(np.float64)
    if cloud.colours is not None:
        for i, colour in enumerate(("Red", "Green", "Blue")):
            columns[f"color{colour}"] = cloud.colours[:, i]
    if cloud.normals is not None:
        for i, axis in enumerate("XYZ"):
            columns[f"nor:normal{axis}"] = cloud.normals[:, i]
    return columns


def _find_limits(
    cloud: PointCloud, columns: Mapping[str, Numbers]
) -> dict[str, dict[str, float | int]]:
    """Return the limits that a scan states: of coordinates, intensities and colours."""
    low, high = (corner + cloud.origin for corner in finite_bounds(cloud.positions))
    bounds: dict[str, float | int] = {}
    for i, axis in enumerate("xyz"):
        bounds |= {f"{axis}Minimum": float(low[i]), f"{axis}Maximum": float(high[i])}
    limits = {"cartesianBounds": bounds}
    intensities = columns.get("intensity", np.empty(0))
    finite = intensities[np.isfinite(intensities)]
    if len(finite):
        limits["intensityLimits"] = {
            "intensityMinimum": float(finite.min()),
            "intensityMaximum": float(finite.max()),
        }
    if cloud.colours is not None:
        most = np.iinfo(cloud.colours.dtype).max
        limits["colorLimits"] = {
            f"color{colour}{end}": value
            for colour in ("Red", "Green", "Blue")
            for end, value in (("Minimum", 0), ("Maximum", most))
        }
    return limits


def _guid(library: _Foreign, image: _Foreign) -> _Foreign:
    return library.StringNode(image, f"{{{uuid.uuid4()}}}")


def _number(library: _Foreign, image: _Foreign, value: float | int) -> _Foreign:
    kind = library.IntegerNode if isinstance(value, int) else library.FloatNode
    return kind(image, value)


def _field(library: _Foreign, image: _Foreign, values: Numbers) -> _Foreign:
    """Return the prototype of a column: floats of double precision, or small integers."""
    if values.dtype.kind == "f":
        return library.FloatNode(image, 0.0, library.E57_DOUBLE)
    return library.IntegerNode(image, 0, 0, int(np.iinfo(values.dtype.str).max))


def _write_columns(
    library: _Foreign, image: _Foreign, points: _Foreign, columns: Mapping[str, Numbers], count: int
) -> None:
    rows = max(min(_ROWS_AT_ONCE, count), 1)
    arrays = {name: np.empty(rows, values.dtype) for name, values in columns.items()}
    buffers = library.VectorSourceDestBuffer()
    for name, array in arrays.items():
        buffers.append(library.SourceDestBuffer(image, name, array, rows, True, True))
    writer = points.writer(buffers)
    for start in range(0, count, rows):
        size = min(rows, count - start)
        for name, values in columns.items():
            arrays[name][:size] = values[start : start + size]
        writer.write(size)
    writer.close()
