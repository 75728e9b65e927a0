"""Point clouds as lines of numbers: .xyz, .pts, .asc, .csv, .txt and their kin.

A file may begin with comments, a line of names, and a number of rows; see `layout` for what is
understood, and `columns` for what columns without names are taken for.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import PointCloud
from hpcapp.io.batches import batch_points
from hpcapp.io.points.point_source import Findings, PointSource, Scan
from hpcapp.io.rows import line_error
from hpcapp.io.text.columns import DEGREES, TableColumns, assign_by_name, assign_by_value
from hpcapp.io.text.layout import TextLayout, find_layout
from hpcapp.io.text.lines import Block, LineReader, read_blocks
from hpcapp.io.text.tables import RowNotes, parse_block

_LEAST_BYTES = 6  # of a row


def open_text(path: Path) -> PointSource:
    """Open lines of numbers as a point cloud: its first lines, and samples, tell its columns.

    Coordinates, normals and colours are as in the file; other columns become attributes. Raise
    InputError, which names the first line that does not fit.
    """
    findings = Findings()
    layout, sample = find_layout(path, findings)
    wanted = layout.rows.wanted
    if layout.names is None:
        columns = assign_by_value(path, sample, wanted, findings, width=layout.rows.columns)
        names = columns.roles
    else:
        columns = assign_by_name([layout.names[i] for i in wanted], sample)
        names = layout.names

    def scan(rows: int) -> Iterator[PointCloud]:
        return batch_points(_read_clouds(path, layout, columns, findings), rows)

    announced = sum(count for _, count in layout.counts)
    return PointSource(
        path,
        announced if 0 < announced <= path.stat().st_size // _LEAST_BYTES else None,
        True,
        columns.has_normals,
        scan,
        format=_describe(layout),
        columns=names,
        scans=tuple(Scan(count) for _, count in layout.counts) or (Scan(),),
        unit=_find_unit(layout, columns),
        findings=findings,
    )


def _find_unit(layout: TextLayout, columns: TableColumns) -> str | None:
    """Return the unit that the name of x tells."""
    if layout.names is None:
        return None
    name = layout.names[layout.rows.wanted[columns.roles.index("x")]].lower()
    in_brackets = re.search(r"[\[(]\s*(m|mm|ft)\s*[\])]$", name)
    return "degree" if name in DEGREES else in_brackets[1] if in_brackets else None


def _describe(layout: TextLayout) -> str:
    separator = {",": "commas", ";": "semicolons", None: "blanks"}[layout.rows.separator]
    return f"text, separated by {separator}"


def _read_clouds(
    path: Path, layout: TextLayout, columns: TableColumns, findings: Findings
) -> Iterator[PointCloud]:
    notes = RowNotes(path)
    rows_of = [0] * max(len(layout.counts), 1)
    for number, block in _read_scans(path, layout):
        table = parse_block(block, layout.rows, notes)
        cloud = columns.make_cloud(table, sum(rows_of), notes)
        if len(rows_of) > 1:
            scan = np.full(len(table), number, np.int32)
            cloud = PointCloud(
                cloud.positions, cloud.normals, cloud.colours, {**cloud.attributes, "scan": scan}
            )
        rows_of[number] += len(table)
        yield cloud
    for (line, count), rows in zip(layout.counts, rows_of, strict=False):
        if count > rows:
            problem = f"truncated: {count} points are announced, {rows} follow"
            raise line_error(path, (line, ""), problem, "copy or export the file again")
        if count < rows:
            notes.note(
                "count", f"line {line} announces {count} points, {rows} follow, and are read"
            )
    notes.tell(findings)


def _read_scans(path: Path, layout: TextLayout) -> Iterator[tuple[int, Block]]:
    """Yield the rows in blocks, with the number of the scan that they are of."""
    lines = LineReader(read_blocks(path, layout.encoding))
    skipped, at = layout.first_row - 1, layout.first_row
    for scan, (line, _) in enumerate([*layout.counts[1:], (sys.maxsize, 0)]):
        for _ in lines.take(skipped):
            pass
        for block in lines.take(line - at):
            yield scan, block
        skipped, at = 1, line + 1
