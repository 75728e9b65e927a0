"""PTX: organised scans with their poses, one behind the other.

Each scan has ten lines before its points: its number of columns and of rows, where the scanner
stood, its axes, and a matrix of four rows that is applied to row vectors ``(x, y, z, 1)``. The
points follow column by column, in the scanner's coordinates: ``x y z``, mostly an intensity, and
perhaps a colour. Where a ray came back from nowhere the point is ``0 0 0``.

References
----------
Leica Geosystems, "Cyclone PTX format".
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.batches import batch_points
from hpcapp.io.columns import Numbers
from hpcapp.io.frame import check_coordinates
from hpcapp.io.points.column_roles import AXES, COLOURS
from hpcapp.io.points.point_source import Findings, PointSource, Scan
from hpcapp.io.rows import is_count, line_error
from hpcapp.io.text.columns import TableColumns
from hpcapp.io.text.lines import Block, LineReader, find_encoding, read_blocks
from hpcapp.io.text.tables import RowFormat, RowNotes, parse_block
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_LAYOUTS = {
    3: AXES,
    4: (*AXES, "intensity"),
    6: AXES + COLOURS,
    7: (*AXES, "intensity", *COLOURS),
}
_MISSING = "missing returns"
_MOST_CELLS = 2**31 - 1  # row and column are int32
_EXPORT_AGAIN = "export the scans again"


@dataclass(frozen=True, slots=True, eq=False)
class _Header:
    """The ten lines before the points of a scan, from `line` on.

    The grid has columns and rows; the pose (4, 3) is what it makes of x, y and z, and what it adds:
    the scanner is at (3,).
    """

    line: int
    grid: tuple[int, int]
    scanner: FloatArray
    pose: FloatArray

    @property
    def cells(self) -> int:
        return self.grid[0] * self.grid[1]


def open_ptx(path: Path) -> PointSource:
    """Open the scans of a PTX file as one point cloud; it is read to its end to find them.

    Poses are applied, missing returns are left out and counted. Raise InputError, which names the
    first line that does not fit, or the scan that is cut.
    """
    encoding = find_encoding(path)
    points = 0
    scans: list[Scan] = []
    layouts: set[tuple[str, ...]] = set()
    for header, blocks in _read_scans(path, encoding):
        lines = 0
        for block in blocks:
            if not lines:
                layouts.add(_find_roles(block, path))
            lines += block[1].count("\n") + (not block[1].endswith("\n"))
        if lines < header.cells:
            raise InputError(
                f"{path}: truncated: {header.cells} points are announced in line {header.line}, "
                f"the file ends after {lines}",
                _EXPORT_AGAIN,
            )
        points += header.cells
        scans.append(Scan(header.cells, header.scanner, header.grid))
    if not layouts:
        raise InputError(f"{path}: no points: the file has no scan", "check the file")
    findings = Findings()
    if len(layouts) > 1:
        findings.warn("some scans lack intensities (NaN) or colours (white) that others have")
    together = set().union(*layouts)
    roles = next(layout for layout in _LAYOUTS.values() if together <= set(layout))

    def scan(rows: int) -> Iterator[PointCloud]:
        return batch_points(_read_clouds(path, encoding, roles, len(scans), findings), rows)

    return PointSource(
        path,
        points,
        True,
        False,
        scan,
        format="PTX",
        columns=roles,
        scans=tuple(scans),
        findings=findings,
    )


def _read_scans(path: Path, encoding: str) -> Iterator[tuple[_Header, Iterator[Block]]]:
    """Yield the header of each scan, and its points in blocks, which must be read to go on."""
    lines = LineReader(read_blocks(path, encoding))
    while (line := lines.next_line()) is not None:
        header = _read_header(line, lines, path)
        yield header, lines.take(header.cells)


def _read_header(line: tuple[int, str], lines: LineReader, path: Path) -> _Header:
    columns = _parse_count(line, path, "columns")
    rows = _parse_count(_next(lines, line, path), path, "rows")
    table = [_parse_numbers(_next(lines, line, path), path, 3 if i < 4 else 4) for i in range(8)]
    matrix = np.array(table[4:])
    if matrix[:, 3].tolist() != [0, 0, 0, 1]:
        problem = f"the matrix of the scan ends in the column {matrix[:, 3].tolist()}"
        raise line_error(path, line, problem, "it must be 0 0 0 1: the fourth row is what it adds")
    scanner = np.array(table[0])
    for numbers in (scanner, matrix):
        check_coordinates(numbers, path, f"the pose of the scan from line {line[0]} on")
    if not scanner.any():
        scanner = matrix[3, :3]  # some programs leave out where the scanner stood
    return _Header(line[0], (columns, rows), scanner, matrix[:, :3])


def _next(lines: LineReader, first: tuple[int, str], path: Path) -> tuple[int, str]:
    line = lines.next_line()
    if line is None:
        raise line_error(path, first, "the file ends within the scan that begins", _EXPORT_AGAIN)
    return line


def _parse_count(line: tuple[int, str], path: Path, what: str) -> int:
    word = line[1].strip()
    if not is_count(word) or int(word) > _MOST_CELLS:
        raise line_error(
            path, line, f"{word[:40]!r} is no number of {what} of a scan", "check the lines before"
        )
    return int(word)


def _parse_numbers(line: tuple[int, str], path: Path, count: int) -> list[float]:
    rows = RowFormat(None, ",", count, tuple(range(count)))
    numbers = parse_block(line, rows, RowNotes(path))
    if not len(numbers) or not np.isfinite(numbers).all():
        problem = f"{line[1][:40]!r} are not {count} finite numbers of a pose"
        raise line_error(path, line, problem, _EXPORT_AGAIN)
    return [float(number) for number in numbers[0]]


def _find_roles(block: Block, path: Path) -> tuple[str, ...]:
    line = block[1].partition("\n")[0]
    columns = len(line.split())
    if columns not in _LAYOUTS:
        problem = f"{columns} columns, none of {', '.join(map(str, _LAYOUTS))}"
        raise line_error(path, (block[0], line), problem, _EXPORT_AGAIN)
    return _LAYOUTS[columns]


def _read_clouds(
    path: Path, encoding: str, roles: tuple[str, ...], scans: int, findings: Findings
) -> Iterator[PointCloud]:
    notes = RowNotes(path)
    points = missing = 0
    for number, (header, blocks) in enumerate(_read_scans(path, encoding)):
        scan_roles: tuple[str, ...] = ()
        first = 0
        for block in blocks:
            scan_roles = scan_roles or _find_roles(block, path)
            rows = RowFormat(None, ",", len(scan_roles), tuple(range(len(scan_roles))))
            table = parse_block(block, rows, notes)
            cells = np.arange(first, first + len(table))
            places = {"column": cells // header.grid[1], "row": cells % header.grid[1]}
            if scans > 1:
                places["scan"] = np.full(len(table), number)
            cloud = TableColumns(scan_roles, "8 bit").make_cloud(table, points + first, notes)
            returned = (cloud.positions != 0).any(axis=1)
            missing += len(table) - int(returned.sum())
            yield _place(_complete(cloud, roles), header.pose, places).take(returned)
            first += len(table)
        if first < header.cells:
            problem = f"the scan announces {header.cells} points and has {first}"
            raise InputError(f"{path}:{header.line}: {problem}", _EXPORT_AGAIN)
        points += first
    if missing:
        findings.dropped[_MISSING] = missing
    notes.tell(findings)


def _complete(cloud: PointCloud, roles: tuple[str, ...]) -> PointCloud:
    """Give a cloud what other scans have and its own lacks."""
    colours: Numbers | None = cloud.colours
    if colours is None and COLOURS[0] in roles:
        colours = np.full((len(cloud), 3), 255, np.uint8)
    attributes = dict(cloud.attributes)
    if "intensity" in roles:
        attributes.setdefault("intensity", np.full(len(cloud), np.nan))
    return PointCloud(cloud.positions, None, colours, attributes)


def _place(cloud: PointCloud, pose: FloatArray, places: dict[str, NDArray[np.int64]]) -> PointCloud:
    """Apply a pose, and say where in the grid the points are."""
    x, y, z = cloud.positions.T
    with np.errstate(over="ignore", invalid="ignore"):  # infinity stays no number
        # Written out: a product of matrices may round otherwise for another number of points.
        positions = np.column_stack([x * a + y * b + z * c + d for a, b, c, d in pose.T])
    numbers = {name: values.astype(np.int32) for name, values in places.items()}
    return PointCloud(positions, None, cloud.colours, {**cloud.attributes, **numbers})
