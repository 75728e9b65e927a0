"""The points of one or several sources as one binary PLY, written in parts."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpcapp.geometry.ply_rows import coordinate_lines, ply_header
from hpcapp.geometry.points import Int32Array, PointCloud
from hpcapp.io.batches import join_arrays
from hpcapp.io.crs import Crs
from hpcapp.io.ply.columns import VertexProperties
from hpcapp.io.ply.comments import keep
from hpcapp.io.points.column_roles import AXES, name_columns, name_some
from hpcapp.io.points.point_source import SCAN, PointSource
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError

log = logging.getLogger("hpcapp")

Choose = Callable[[PointSource], PointSource]

_ROWS_AT_ONCE = 1 << 18
_COUNT_DIGITS = 20  # the count is known when the last point is written


def write_joined(
    path: Path, sources: Sequence[PointSource], choose: Choose | None = None, sampled: int = 0
) -> int:
    """Write the points of sources, one after the other, as one PLY; return their number.

    Memory is bounded where all sources stream. Coordinates are written as ``double``, in those of
    the sources; normals as ``float``. Points of sources without colours are white where others have
    some; other columns that only some have are left out, with a warning. `choose` takes all of them
    as one source, and returns those of its points that are written; readers are told how many were
    sampled on the faces of meshes, unasked. Raise InputError where a source is damaged, or has
    another unit or coordinate reference system.
    """
    refuse_mixed(sources)
    layout = _find_common(sources)
    properties = VertexProperties.of(layout)
    dtype = np.dtype([*((axis, "<f8") for axis in AXES), *properties.fields])
    joined = _chain(path, sources, layout)
    count = 0
    with replacing(path) as file:
        file.write(_make_header(0, properties, sources, sampled))
        for part in (joined if choose is None else choose(joined)).chunks(_ROWS_AT_ONCE):
            rows = np.empty(len(part), dtype)
            for axis, values in zip(AXES, part.positions.T, strict=True):
                rows[axis] = values
            properties.fill(rows, part)
            file.write(rows.data)
            count += len(part)
        file.seek(0)
        file.write(_make_header(count, properties, sources, sampled))
    return count


def refuse_mixed(
    sources: Sequence[PointSource], whats: Sequence[str] = ("unit", "height_unit", "crs")
) -> None:
    """Raise InputError where coordinates of sources do not mean the same."""
    for what in whats:
        known = [(source, getattr(source, what)) for source in sources if getattr(source, what)]
        for source, value in known[1:]:
            if value != known[0][1]:
                name = "coordinate reference system" if what == "crs" else "unit"
                raise InputError(
                    f"{source.path} has another {name} than {known[0][0].path}: "
                    f"{str(value)[:60]}, not {str(known[0][1])[:60]}",
                    "convert the files to one frame first",
                )


def _find_common(sources: Sequence[PointSource]) -> PointCloud:
    """Return the columns that all sources have, and colours where one has some, without points."""
    number = {SCAN: np.empty(0, np.int32)} if len(sources) > 1 else {}
    layouts = [_find_layout(source, number) for source in sources]
    names = [name_columns(replace(layout, colours=None)) for layout in layouts]
    common = set(names[0]).intersection(*names)
    colours = join_arrays(layout.colours for layout in layouts)
    for columns, layout, source in zip(names, layouts, sources, strict=True):
        if lost := [name for name in columns if name not in common]:
            log.warning(
                "warning: %s: all points stay; left out of each, as not all files have it: %s",
                source.path, name_some(lost),
            )  # fmt: skip
        if colours is not None and layout.colours is None:
            log.warning("warning: %s: no colours, as other files have: white there", source.path)
    return PointCloud(
        np.empty((0, 3)),
        layouts[0].normals if all(one.normals is not None for one in layouts) else None,
        colours,
        {
            name: np.concatenate([layout.attributes[name] for layout in layouts])
            for name in layouts[0].attributes
            if name in common
        },
    )


def _find_layout(source: PointSource, more: Mapping[str, Int32Array]) -> PointCloud:
    """Return the columns of a source, and further ones, without points."""
    layout = next(source.chunks(1)).view(slice(0))
    return replace(layout, attributes={**more, **layout.attributes})


def _chain(path: Path, sources: Sequence[PointSource], layout: PointCloud) -> PointSource:
    """Return the points of sources, one after the other, with the columns of a layout."""
    first_scans = np.cumsum([0, *(len(source.scans) for source in sources)])

    def scan(rows: int) -> Iterator[PointCloud]:
        for source, first_scan in zip(sources, first_scans, strict=False):
            for part in source.chunks(rows):
                yield _select(part, layout, int(first_scan))

    frame = _find_frame(sources)
    return PointSource(
        path, None, True, layout.normals is not None, scan,
        crs=frame.text, unit=frame.unit, height_unit=frame.height_unit,
    )  # fmt: skip


def _find_frame(sources: Sequence[PointSource]) -> Crs:
    """Return what the coordinates of sources mean, by those that say it."""
    return Crs(
        *(
            next((value for source in sources if (value := getattr(source, what))), None)
            for what in ("crs", "unit", "height_unit")
        )
    )


def _select(part: PointCloud, layout: PointCloud, first_scan: int) -> PointCloud:
    """Return the columns that are written of a part; scans are numbered on."""
    columns = dict(part.attributes)
    if SCAN in layout.attributes:
        columns[SCAN] = columns.get(SCAN, np.zeros(len(part), np.int32)) + first_scan
    colours = None
    if layout.colours is not None:
        white = np.full((len(part), 3), 255, np.uint8)
        colours = white if part.colours is None else part.colours
    return PointCloud(
        part.positions,
        part.normals if layout.normals is not None else None,
        colours,
        {name: columns[name] for name in layout.attributes},
    )


def _make_header(
    count: int, properties: VertexProperties, sources: Sequence[PointSource], sampled: int
) -> bytes:
    """Return the header; as long for any count."""
    scans = [scan for source in sources for scan in source.scans]
    joined = [f"comment joined {_name_formats(sources)}"] if len(sources) > 1 else []
    filling = "comment ".ljust(8 + _COUNT_DIGITS - len(str(count)), "-")
    return ply_header(
        [
            *joined,
            *keep(_find_frame(sources), scans, sampled),
            *coordinate_lines(count, True),
            *properties.lines,
            filling,
        ]
    )


def _name_formats(sources: Sequence[PointSource]) -> str:
    formats = dict.fromkeys(source.format for source in sources)
    return f"{len(sources)} files: {'; '.join(formats)}"
