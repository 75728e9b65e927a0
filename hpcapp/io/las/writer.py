"""Write LAS 1.4 and LAZ: point format 6, or 7 where there are colours."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.extras import load_library
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.crs import UNIT_CODES, Crs, is_geocentric, parse_epsg
from hpcapp.io.frame import finite_bounds
from hpcapp.io.las.layout import DEGREES_A_STEP
from hpcapp.io.points.usable import drop_non_finite
from hpcapp.io.staging import replacing
from hpccomponent.errors import OutputError

_Foreign = Any  # of laspy, which has no stubs

_FINEST = 1e-6  # length units; of small clouds, the same share of their extent
_MOST_STEPS = 4e9  # of an int32, counted from the middle, with room for a rounded offset
_ROWS_AT_ONCE = 1 << 18
_LONGEST_NAME = 31  # bytes
_LONGEST_RECORD = 65535
_USER_DEFINED = 32767  # code of a system that has none

_MOST = {
    "intensity": 65535,
    "classification": 255,
    "return_number": 15,
    "number_of_returns": 15,
    "user_data": 255,
    "point_source_id": 65535,
}
_STEEPEST = 180.0  # degrees of the scan angle


def write_las(
    path: Path,
    cloud: PointCloud,
    crs: str | None = None,
    unit: str | None = None,
    height_unit: str | None = None,
) -> None:
    """Write a point cloud as LAS, or as LAZ where the suffix says so, in the input's frame.

    Colours of 8 bits become 16. Normals become extra bytes ``NormalX``, ``NormalY``, ``NormalZ``;
    so do attributes that no field of the format holds, or whose values it cannot hold: these get
    ``_raw`` behind their name. Intensities that are no whole numbers of 16 bits are in both places:
    scaled, and as they are. The crs is WKT or an EPSG code, a mere name is not kept; units are
    named as by `UNIT_CODES`, but WKT states its own.

    Coordinates are rounded to a millionth of the unit or, if that is less, of the extent; to more
    where 32 bits do not suffice, above an extent of 4,000 units. Raise OutputError where the file
    cannot be written, or no point has finite coordinates.
    """
    laspy = load_library("laspy", f"{path}: LAS is written with the package laspy", "las")
    cloud = drop_non_finite(cloud, path)
    header = laspy.LasHeader(version="1.4", point_format=6 if cloud.colours is None else 7)
    header.generating_software = "hpcapp"
    scale, offset = choose_grid(*(c + cloud.origin for c in finite_bounds(cloud.positions)))
    header.scales, header.offsets = np.full(3, scale), offset
    layout = header.point_format
    reserved = {*layout.dimension_names, *layout.dtype().names, *"xyz"}
    fields, extras = _assign(cloud, reserved)
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name, values.dtype) for name, values in extras.items()]
    )
    _add_crs(laspy, header, Crs(crs, unit, height_unit), path)
    is_compressed = path.suffix.lower() == ".laz"
    with (
        replacing(path) as file,
        _translated(laspy, path),
        laspy.LasWriter(file, header, do_compress=is_compressed, closefd=False) as writer,
    ):
        for start in range(0, len(cloud), _ROWS_AT_ONCE):
            rows = slice(start, min(start + _ROWS_AT_ONCE, len(cloud)))
            points = laspy.ScaleAwarePointRecord.zeros(rows.stop - start, header=header)
            steps = np.rint((cloud.positions[rows] + (cloud.origin - offset)) / scale)
            for axis, name in enumerate("XYZ"):
                points[name] = steps[:, axis].astype(np.int32)
            for name, values in (fields | extras).items():
                points[name] = values[rows]
            writer.write_points(points)


@contextmanager
def _translated(laspy: _Foreign, path: Path) -> Iterator[None]:
    """Turn errors of laspy and of the compressors, which write by themselves, into ours."""
    try:
        yield
    except (RuntimeError, laspy.errors.LaspyException) as error:
        why = str(error).partition("\n")[0]
        raise OutputError(f"{path}: cannot be written: {why}", "check for room") from error


def choose_grid(low: FloatArray, high: FloatArray) -> tuple[float, FloatArray]:
    """Choose the grid to which coordinates in a box between two corners, (3,), are rounded.

    Return the width of a cell, a power of ten, and a point of the grid near the middle, (3,), of
    round numbers.

    Examples
    --------
    >>> choose_grid(np.array([10.0, 20.0, 0.0]), np.array([12.0, 30.0, 4.0]))
    (1e-06, array([11., 25.,  2.]))
    """
    extent = float((high - low).max())
    finest = min(1.0, extent or 1.0) * _FINEST
    power = math.floor(math.log10(finest) + 1e-9)
    if extent:
        power = max(power, math.ceil(math.log10(extent / _MOST_STEPS)))
    offset = np.array([round(float(middle), -(power + 6)) for middle in low / 2 + high / 2])
    return float(f"1e{power}"), offset


def _assign(cloud: PointCloud, reserved: set[str]) -> tuple[dict[str, Numbers], dict[str, Numbers]]:
    """Assign columns to the fields of the format, and what is left to extra bytes."""
    once = np.ones(len(cloud), np.uint8)
    fields: dict[str, Numbers] = {"return_number": once, "number_of_returns": once}
    extras: dict[str, Numbers] = {}
    if cloud.colours is not None:
        widened = cloud.colours.astype(np.uint16)
        if cloud.colours.dtype == np.uint8:
            widened *= 257
        fields |= {name: widened[:, i] for i, name in enumerate(("red", "green", "blue"))}
    if cloud.normals is not None:
        for i, axis in enumerate("XYZ"):
            extras[f"Normal{axis}"] = cloud.normals[:, i].astype(np.float32)
    for name, values in cloud.attributes.items():
        field = _as_field(name, values)
        if field is None:
            extras[_free_name(name, reserved, extras)] = _as_extra(values)
            field = _stretch(values) if name == "intensity" else None
        if field is not None:
            fields[name] = field
    return fields, extras


def _as_field(name: str, values: NDArray[Any]) -> Numbers | None:
    """Return an attribute as the field of its name has it; None where there is no room for it."""
    if name == "gps_time":
        return values.astype(np.float64)
    if name == "scan_angle" and np.abs(values).max(initial=0) <= _STEEPEST:
        steps: Numbers = np.rint(values / DEGREES_A_STEP).astype(np.int16)
        return steps
    return values.astype(np.uint16) if name in _MOST and _is_whole(values, _MOST[name]) else None


def _stretch(values: Numbers) -> NDArray[np.uint16]:
    """Scale values to what an intensity can be; without a value it is 0."""
    finite = np.where(np.isfinite(values), values, np.nan)
    low, high = (np.nanmin(finite), np.nanmax(finite)) if np.isfinite(values).any() else (0, 0)
    share = (finite - low) / (high - low or 1)
    return np.rint(np.nan_to_num(share) * _MOST["intensity"]).astype(np.uint16)


def _is_whole(values: Numbers, most: int) -> bool:
    with np.errstate(invalid="ignore"):
        return bool(((values >= 0) & (values <= most) & (values == np.rint(values))).all())


def _as_extra(values: Numbers) -> Numbers:
    """Return values in a type that extra bytes can have."""
    if values.dtype.kind in "iu":
        return values.astype(values.dtype.newbyteorder("="))
    small = values.dtype.kind == "f" and values.dtype.itemsize <= 4
    return values.astype(np.uint8 if values.dtype.kind == "b" else np.float32 if small else float)


def _free_name(name: str, reserved: set[str], taken: Mapping[str, object]) -> str:
    """Cut a name to what a description has room for; names stay different."""
    name = f"{name}_raw" if name in reserved else name
    free, number = name.encode()[:_LONGEST_NAME].decode(errors="ignore") or "extra", 1
    while free in taken:
        number += 1
        free = name.encode()[: _LONGEST_NAME - 4].decode(errors="ignore") + f"_{number}"
    return free


def _add_crs(laspy: _Foreign, header: _Foreign, crs: Crs, path: Path) -> None:
    """Add the coordinate reference system and the unit: as WKT, or GeoTIFF keys without it."""
    wkt = crs.text if crs.text is not None and "[" in crs.text else None
    is_wkt = wkt is not None
    record = _encode_keys(crs) if wkt is None else wkt.encode() + b"\0"
    if len(record) > _LONGEST_RECORD:
        raise OutputError(
            f"{path}: the coordinate reference system has {len(record)} bytes",
            f"LAS holds {_LONGEST_RECORD}: name it by its EPSG code",
        )
    if record:
        header.global_encoding.wkt = is_wkt
        header.vlrs.append(laspy.VLR("LASF_Projection", 2112 if is_wkt else 34735, "", record))


def _encode_keys(crs: Crs) -> bytes:
    """Return GeoTIFF keys for the code of a coordinate reference system and for its units."""
    code, unit = parse_epsg(crs.text) if crs.text else None, crs.unit
    is_centred = is_geocentric(crs.text)
    is_geographic = code is not None and 4000 <= code < 5000 and not is_centred  # by EPSG
    keys = {}
    if code is not None:
        keys[2048 if is_geographic or is_centred else 3072] = code
    if unit in UNIT_CODES and is_centred:
        keys[2052] = UNIT_CODES[unit]
    elif unit in UNIT_CODES and not is_geographic:
        keys.setdefault(3072, _USER_DEFINED)
        keys[3076] = UNIT_CODES[unit]
    if crs.height_unit in UNIT_CODES:
        keys[4099] = UNIT_CODES[crs.height_unit]
    if not keys:
        return b""
    keys = {1024: 3 if is_centred else 2 if is_geographic else 1, **keys}
    entries = [number for key, value in keys.items() for number in (key, 0, 1, value)]
    return struct.pack(f"<{4 + len(entries)}H", 1, 1, 0, len(keys), *entries)
