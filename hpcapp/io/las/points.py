"""The points of a LAS, LAZ or COPC file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import ByteArray, PointCloud
from hpcapp.geometry.regions.region import Area
from hpcapp.io.batches import batch_points
from hpcapp.io.las.copc import Chunk, find_chunks, has_octree
from hpcapp.io.las.decompression import Take, find_library, open_chunks, open_decompressor
from hpcapp.io.las.header import LasHeader, find_crs, read_header
from hpcapp.io.las.layout import LasLayout, find_layout
from hpcapp.io.points.point_source import Findings, Octree, PointSource, Read, Scan, keep_small
from hpccomponent.errors import InputError
from hpccomponent.limits import available_cores

_COORDINATES = 12  # bytes of a point that hold its coordinates
_A_CORE = 1 << 17  # compressed points that are taken at once: some chunks, which stay in the cache
_LARGEST_PART = 1 << 28  # bytes of them, as a file may say that a point has 65,535


def open_las(path: Path, *, keeps_noise: bool = False) -> PointSource:
    """Open the points of a LAS, LAZ or COPC file.

    Points that are flagged as withheld, and those of the classes for noise unless these are kept,
    are left out and counted. Waveforms are passed over. COPC is read in the order of the file,
    which is that of its octree; of a part of space, the nodes that reach into it. Colours are of 16
    bits: the values of the file, whatever their range. Normals come from extra bytes with names as
    ``NormalX``. Raise InputError where the file is cut, its header is damaged, or it holds no
    points.
    """
    findings = Findings()
    with path.open("rb") as file:
        header = _read_sound_header(file, path, findings)
        if header.is_compressed:
            find_library(header, path)
    layout = find_layout(header, path)
    crs = find_crs(header.records)

    def scan(rows: int) -> Iterator[PointCloud]:
        findings.dropped.clear()  # they are counted anew
        at_once = _count_at_once(header) if header.is_compressed else rows
        parts = _read_points(path, header, layout, min(rows, at_once), findings)
        return batch_points(_decode_parts(parts, layout, findings, keeps_noise), rows)

    def read_nodes(area: Area) -> Read:
        def read(rows: int) -> Iterator[PointCloud]:
            findings.dropped.clear()
            parts = _read_chunks(path, header, layout, find_chunks(path, header, area))
            return batch_points(_decode_parts(parts, layout, findings, keeps_noise), rows)

        return read

    is_octree = has_octree(header) and find_library(header, path) == "lazrs"
    source = PointSource(
        path,
        header.count,
        True,
        layout.has_normals,
        scan,
        format=_describe(header),
        columns=layout.columns,
        scans=(Scan(header.count),),
        crs=crs.text if crs else None,
        unit=crs.unit if crs else None,
        height_unit=crs.height_unit if crs else None,
        findings=findings,
        octree=Octree(header.low, header.high, read_nodes) if is_octree else None,
    )
    return keep_small(source) if header.is_compressed else source


def _decode_parts(
    parts: Iterator[NDArray[np.void]], layout: LasLayout, findings: Findings, keeps_noise: bool
) -> Iterator[PointCloud]:
    """Yield the points that are some; first, a part without points."""
    yield layout.decode(np.empty(0, layout.dtype))
    for points in parts:
        withheld, noise = layout.select(points)
        noise &= not keeps_noise
        left_out = withheld | noise
        if left_out.any():
            findings.drop("withheld", int(withheld.sum()))
            findings.drop("noise", int(noise.sum()))
            points = points[~left_out]
        if len(points):
            yield layout.decode(points)


def _describe(header: LasHeader) -> str:
    name = "LAS"
    if header.is_compressed:
        name = "COPC" if ("copc", 1) in header.records else "LAZ"
    major, minor = header.version
    return f"{name} {major}.{minor}, point format {header.point_format}"


def _read_sound_header(file: BinaryIO, path: Path, findings: Findings) -> LasHeader:
    """Read the header; what it announces must be there."""
    header = read_header(file, path, findings)
    if not header.count:
        raise InputError(
            f"{path}: no points: the header announces none",
            "check that the right file was exported",
        )
    if header.is_compressed:
        return header
    there = file.seek(0, os.SEEK_END) - header.points_start
    whole, rest = divmod(there, max(header.record_length, 1))
    if whole == header.count - 1 and rest >= _COORDINATES:
        findings.warn("the last point is cut behind its coordinates; its other columns are zero")
    elif whole < header.count:
        raise InputError(
            f"{path}: ends after {whole} of {header.count} points",
            "the file is cut: copy or export it again",
        )
    elif whole > header.count and not header.has_tail:
        findings.warn(
            f"the header announces {header.count} points, the file has room for {whole}: the "
            "others are left out"
        )
    return header


def _count_at_once(header: LasHeader) -> int:
    """Return how many compressed points are taken at once."""
    return min(_A_CORE * available_cores(), _LARGEST_PART // header.record_length)


def _read_points(
    path: Path, header: LasHeader, layout: LasLayout, rows: int, findings: Findings
) -> Iterator[NDArray[np.void]]:
    """Yield the points of a file, so many at a time; each part may overwrite the one before."""
    with _open_bytes(path, header, rows, findings) as take:
        for start in range(0, header.count, rows):
            size = min(rows, header.count - start) * header.record_length
            yield take(size).view(layout.dtype)


def _read_chunks(
    path: Path, header: LasHeader, layout: LasLayout, chunks: Sequence[Chunk]
) -> Iterator[NDArray[np.void]]:
    """Yield the points of chunks, some at a time; each part may overwrite the one before."""
    if not chunks:
        return
    rows = max(_count_at_once(header), max(chunk.points for chunk in chunks))
    with open_chunks(path, header, rows) as take:
        waiting: list[Chunk] = []
        for chunk in chunks:
            if waiting and sum(one.points for one in [*waiting, chunk]) > rows:
                yield take(waiting).view(layout.dtype)
                waiting = []
            waiting.append(chunk)
        yield take(waiting).view(layout.dtype)


@contextmanager
def _open_bytes(path: Path, header: LasHeader, rows: int, findings: Findings) -> Iterator[Take]:
    if header.is_compressed:
        with open_decompressor(path, header, rows, findings) as take:
            yield take
        return
    with path.open("rb") as file:
        file.seek(header.points_start)
        yield _read_plain(file, path, header.record_length - _COORDINATES)


def _read_plain(file: BinaryIO, path: Path, spared: int) -> Take:
    """Return what takes bytes from a file; `spared` may be missing at its end, and are zero."""

    def take(size: int) -> ByteArray:
        points: ByteArray = np.zeros(size, np.uint8)
        if file.readinto(points) + spared < size:  # type: ignore[attr-defined]
            raise InputError(f"{path}: ends before its last point", "copy or export it again")
        return points

    return take
