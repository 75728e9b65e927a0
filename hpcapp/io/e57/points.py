"""The points of an E57 file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from hpcapp.extras import require_library
from hpcapp.geometry.points import FloatArray, Int32Array, PointCloud
from hpcapp.io.batches import batch_points
from hpcapp.io.columns import Numbers
from hpcapp.io.e57.document import XmlElement, read_document, refuse
from hpcapp.io.e57.scans import (
    GRID,
    SPHERICAL,
    E57Scan,
    bound_grids,
    describe_scan,
    holds_more,
    open_fields,
    read_fields,
)
from hpcapp.io.points.column_roles import COLOURS, NORMALS
from hpcapp.io.points.point_source import Findings, PointSource, Scan, keep_small
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_AT_ONCE = 1 << 16  # points: what is made of them stays in the cache
_WHITE: dict[type[np.generic], int] = {np.uint8: 255, np.uint16: 65535}
_COLOURLESS = "colours: they are white"
_NOWHERE = -1  # row and column of a point that belongs to no grid


@dataclass(frozen=True, slots=True)
class _Columns:
    """What every part of a file has, whichever scan it is of."""

    has_normals: bool
    colours: type[np.generic] | None
    has_grid: bool
    has_scan: bool
    attributes: tuple[str, ...]


def open_e57(path: Path) -> PointSource:
    """Open the points of all scans of an E57 file, their poses applied.

    Points that the file says are invalid are left out and counted. Columns that a scan lacks and
    another has are NaN, white for colours and zero for normals; normals are left out where not even
    half of the points have them. A scan without a pose has the identity, and its scanner at the
    origin. Colours are of 8 bits where all scans say so, else of 16, or floats as in the file.
    Raise InputError where the file is damaged, or holds no scan or no points.
    """
    require_library("pye57", f"{path}: E57 needs the package pye57", "e57")
    findings = Findings()
    root = read_document(path)
    try:
        scans = _describe_scans(root, path, findings)
    except (ValueError, OverflowError) as error:  # of a number
        raise refuse(path, f"its XML: {error}") from None
    columns = _join_columns(scans, findings)

    def scan(rows: int) -> Iterator[PointCloud]:
        findings.dropped.clear()  # they are counted anew
        return batch_points(
            _decode_parts(path, scans, columns, min(rows, _AT_ONCE), findings), rows
        )

    source = PointSource(
        path,
        sum(one.points for one in scans),
        True,
        columns.has_normals,
        scan,
        format="E57",
        columns=_names(scans),
        scans=_place_scanners(scans),
        crs=_find_crs(root),
        unit="m",  # by the standard
        findings=findings,
    )
    return keep_small(source)


def _place_scanners(scans: Sequence[E57Scan]) -> tuple[Scan, ...]:
    """Tell where the scanners stood.

    What was exported as a cloud of points has no pose, as has what stands where its scanner has
    put it: only this has a grid or spherical coordinates.
    """
    are_posed = any(one.is_posed for one in scans)
    return tuple(
        Scan(one.points, one.translation if are_posed or one.is_ranged else None, one.grid)
        for one in scans
    )


def _describe_scans(root: XmlElement, path: Path, findings: Findings) -> list[E57Scan]:
    nodes = root.find("data3D")
    if nodes is None or not nodes.children:
        raise InputError(f"{path}: holds no scan", "check that the right file was exported")
    scans = [describe_scan(node, i, path) for i, node in enumerate(nodes.children)]
    for node, one in zip(nodes.children, scans, strict=True):
        if holds_more(node, one.points, path):
            findings.warn(
                f"scan {one.index} declares {one.points} points, and holds more: the others are "
                "left out"
            )
    if not any(one.points for one in scans):
        raise InputError(
            f"{path}: no points: its scans are empty", "check that the right file was exported"
        )
    return bound_grids(scans, path)


def _find_crs(root: XmlElement) -> str | None:
    stated = root.find("coordinateMetadata")
    return None if stated is None else stated.text.strip() or None


def _names(scans: Sequence[E57Scan]) -> tuple[str, ...]:
    names: dict[str, None] = {}
    for one in scans:
        names.update(dict.fromkeys((*one.position, *one.columns.values())))
    return tuple(names)


def _join_columns(scans: Sequence[E57Scan], findings: Findings) -> _Columns:
    """Decide what every part has; say what some scans lack."""
    total, with_normals, with_colours = (
        sum(one.points for one in scans if one.has(names)) for names in ((), NORMALS, COLOURS)
    )
    has_normals = 2 * with_normals > total
    done = "these are zero there" if has_normals else "no normals are kept"
    for covered, what in ((with_normals, f"normals: {done}"), (with_colours, _COLOURLESS)):
        if 0 < covered < total:
            findings.warn(f"{total - covered} of {total} points are of scans without {what}")
    names = dict.fromkeys(name for one in scans for name in one.columns)
    return _Columns(
        has_normals,
        _choose_colour_type(scans) if with_colours else None,
        any(one.grid for one in scans),
        len(scans) > 1,
        tuple(name for name in names if name not in (*NORMALS, *COLOURS, *GRID)),
    )


def _choose_colour_type(scans: Sequence[E57Scan]) -> type[np.generic]:
    limits = {one.colour_limit for one in scans if one.has(COLOURS)}
    if None in limits:
        return np.float64
    return np.uint8 if limits == {255.0} else np.uint16


def _decode_parts(
    path: Path, scans: Sequence[E57Scan], columns: _Columns, rows: int, findings: Findings
) -> Iterator[PointCloud]:
    """Yield the valid points of all scans, some at a time; first, a part without points."""
    yield _decode({name: np.zeros(0) for name in scans[0].fields}, scans[0], columns)
    with open_fields(path, scans, rows) as decoder:
        for one in scans:
            parts = read_fields(decoder, one, one.fields, rows, path)
            for fields in _drop_invalid(parts, one, findings):
                yield _decode(fields, one, columns)


def _drop_invalid(
    parts: Iterator[dict[str, FloatArray]], one: E57Scan, findings: Findings
) -> Iterator[dict[str, FloatArray]]:
    """Leave out the points that a scan says are invalid."""
    for fields in parts:
        if one.invalid is None:
            yield fields
            continue
        valid = fields[one.invalid] == 0
        findings.drop("invalid", int((~valid).sum()))
        if valid.any():
            yield {name: values[valid] for name, values in fields.items()}


def _decode(fields: dict[str, FloatArray], one: E57Scan, columns: _Columns) -> PointCloud:
    """Return a scan's points as a cloud in the file's coordinates."""
    count = len(fields[one.position[0]])

    def stack(names: Iterable[str]) -> FloatArray:
        return np.stack([fields[name] for name in names], axis=1)

    positions = stack(one.position)
    if one.position is SPHERICAL:
        positions = _from_spherical(positions)
    positions = _rotate(positions, one.rotation) + one.translation
    normals: FloatArray | None = None
    if columns.has_normals:
        normals = np.zeros((count, 3))
        if one.has(NORMALS):
            normals = _rotate(stack(one.columns[name] for name in NORMALS), one.rotation)
    colours: Numbers | None = None
    if columns.colours is not None:
        white = _WHITE.get(columns.colours, np.nan)  # what that is will be judged
        colours = np.full((count, 3), white, columns.colours)
        if one.has(COLOURS):
            colours = _scale(stack(one.columns[name] for name in COLOURS), one, columns.colours)
    return PointCloud(positions, normals, colours, _decode_attributes(fields, one, columns))


def _decode_attributes(
    fields: dict[str, FloatArray], one: E57Scan, columns: _Columns
) -> dict[str, Numbers]:
    count = len(fields[one.position[0]])
    attributes: dict[str, Numbers] = {}
    for name in columns.attributes:
        has_column = name in one.columns
        attributes[name] = (
            fields[one.columns[name]].copy() if has_column else np.full(count, np.nan)
        )
    for name, least in zip(GRID, one.corner, strict=True) if columns.has_grid else ():
        place: Int32Array = np.full(count, _NOWHERE, np.int32)
        if one.grid:
            place = (fields[one.columns[name]] - least).astype(np.int32)
        attributes[name] = place
    if columns.has_scan:
        attributes["scan"] = np.full(count, one.index, np.int32)
    return attributes


def _rotate(vectors: FloatArray, rotation: FloatArray) -> FloatArray:
    """Rotate vectors, to the same bits however many there are: a matrix product is not so."""
    if (rotation == np.eye(3)).all():
        return vectors
    x, y, z = vectors.T
    return np.stack([a * x + b * y + c * z for a, b, c in rotation], axis=1)


def _from_spherical(points: FloatArray) -> FloatArray:
    """Convert range, azimuth and elevation, in metres and radians, to coordinates."""
    distance, azimuth, elevation = points.T
    flat = distance * np.cos(elevation)
    return np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1
    )


def _scale(colours: FloatArray, one: E57Scan, dtype: type[np.generic]) -> Numbers:
    """Bring colours to the type of the file; as they are where their limit is that of the type."""
    if dtype not in _WHITE or one.colour_limit is None:
        return colours
    most = _WHITE[dtype]
    scaled: FloatArray = np.nan_to_num(colours)
    if one.colour_limit != most:
        scaled = np.rint(scaled * (most / one.colour_limit))
    return np.clip(scaled, 0, most, out=scaled).astype(dtype)
