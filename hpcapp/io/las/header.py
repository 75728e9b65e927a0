"""The header of a LAS file and the variable length records behind it.

Every number in it may be wrong. What bounds it is the size of the file and the place where the
points begin; the number of records is only believed as far as there are records.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.crs import Crs, parse_geokeys, parse_wkt
from hpcapp.io.frame import check_coordinates
from hpcapp.io.points.point_source import Findings
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_FIXED = struct.Struct("<4s20x2B68xHIIBHI20x12d")  # of 227 bytes, as in LAS 1.0 to 1.2
_EXTENDED = struct.Struct("<QIQ")  # at byte 235 in LAS 1.4: start and number of EVLRs, points
_EXTENDED_SIZE = 375
_RECORD = struct.Struct("<2x16sHH32x")
_LONG_RECORD = struct.Struct("<2x16sHQ32x")
_MOST_PAYLOAD = 1 << 20  # of a record that is kept: a CRS in WKT takes some thousand bytes
_LARGEST = 2.0**31  # coordinate, before it is scaled
_COMPRESSED = 0xC0  # bits of the point format that LAZ sets

_WAVEFORMS = (4, 5, 9, 10)  # point formats whose waveforms may be behind the points

_KEPT = {
    ("laszip encoded", 22204),
    ("LASF_Spec", 4),
    ("copc", 1),
    ("LASF_Projection", 34735),
    ("LASF_Projection", 34737),
    ("LASF_Projection", 2112),
    ("liblas", 2112),
}

Records = dict[tuple[str, int], bytes]


@dataclass(frozen=True, slots=True, eq=False)
class LasHeader:
    """What the header of a LAS file says.

    Parameters
    ----------
    version : tuple of int
        Major and minor.
    point_format : int
        From 0 to 10.
    points_start : int
        Byte at which the points begin.
    record_length : int
        Bytes of a point, uncompressed.
    count : int
        How many points it announces.
    scales, offsets : ndarray of float64, shape (3,)
        Coordinates are integers times scale plus offset.
    low, high : ndarray of float64, shape (3,)
        Between which the points lie.
    records : dict of tuple of str and int to bytes
        Payloads of the variable length records that say something about points, by user and
        number.
    has_tail : bool
        Whether something else than points is behind them: long records, or waveforms.
    """

    version: tuple[int, int]
    point_format: int
    is_compressed: bool
    points_start: int
    record_length: int
    count: int
    scales: FloatArray
    offsets: FloatArray
    low: FloatArray
    high: FloatArray
    records: Records
    has_tail: bool


def read_header(file: BinaryIO, path: Path, findings: Findings) -> LasHeader:
    """Read the header of a LAS file; warn where there are fewer records than announced.

    Raise InputError where this is no LAS file, or its header contradicts the file's size.
    """
    start = file.read(_EXTENDED_SIZE)
    if start[:4] != b"LASF":
        raise InputError(
            f"{path}: is no LAS file: it does not begin with LASF", "check the file's name"
        )
    if len(start) < _FIXED.size:
        raise _cut(path, "in its header")
    _, major, minor, header_size, points_start, announced, bits, length, count, *rest = (
        _FIXED.unpack_from(start)
    )
    extended = None
    if minor >= 4 and header_size >= _EXTENDED_SIZE <= len(start):
        extended = _EXTENDED.unpack_from(start, 235)
        count = extended[2] or count
    size = file.seek(0, os.SEEK_END)
    if not _FIXED.size <= header_size <= points_start:
        raise InputError(
            f"{path}: the header is damaged: {header_size} bytes long, points from byte "
            f"{points_start}",
            "export the file again",
        )
    if points_start > size:
        raise _cut(path, f"before its points, which begin at byte {points_start}")
    present, records = _read_records(file, (header_size, points_start), announced, _RECORD)
    if present < announced:
        findings.warn(
            f"the header announces {announced} variable length records, there are {present}"
        )
    if extended is not None and points_start < extended[0] < size:
        _, long = _read_records(file, (extended[0], size), extended[1], _LONG_RECORD)
        records = {**long, **records}
    header = LasHeader(
        (major, minor), bits & ~_COMPRESSED, bool(bits & _COMPRESSED), points_start, length, count,
        np.array(rest[:3]), np.array(rest[3:6]), np.array(rest[7:12:2]), np.array(rest[6:12:2]),
        records,
        minor >= 3 and (extended is None or extended[1] > 0 or bits & 0x3F in _WAVEFORMS),
    )  # fmt: skip
    if not header.scales.all():
        raise InputError(
            f"{path}: the header is damaged: scale {header.scales.tolist()}",
            "export the file again",
        )
    check_coordinates(header.scales * _LARGEST, path, "the scale of 32-bit coordinates")
    check_coordinates(header.offsets, path, "the offset of the header")
    return header


def _read_records(
    file: BinaryIO, place: tuple[int, int], announced: int, layout: struct.Struct
) -> tuple[int, Records]:
    """Walk through variable length records as long as there are any; count them, keep some."""
    kept: Records = {}
    present = 0
    for user, number, payload, length in _walk(file, place, announced, layout):
        present += 1
        name = user.split(b"\0")[0].decode("latin-1")
        if (name, number) in _KEPT and length <= _MOST_PAYLOAD:
            file.seek(payload)
            kept.setdefault((name, number), file.read(length))
    return present, kept


def _walk(
    file: BinaryIO, place: tuple[int, int], announced: int, layout: struct.Struct
) -> Iterator[tuple[bytes, int, int, int]]:
    at, end = place
    for _ in range(announced):
        file.seek(at)
        head = file.read(layout.size)
        if at + layout.size > end or len(head) < layout.size:
            return
        user, number, length = layout.unpack(head)
        if not head.strip(b"\0") or at + layout.size + length > end:
            return
        yield user, number, at + layout.size, length
        at += layout.size + length


def _cut(path: Path, where: str) -> InputError:
    return InputError(f"{path}: ends {where}", "the file is cut: copy or export it again")


def find_crs(records: Records) -> Crs | None:
    """Return the coordinate reference system that a header's records state, if they do."""
    keys = None
    if ("LASF_Projection", 34735) in records:
        texts = records.get(("LASF_Projection", 34737), b"")
        keys = parse_geokeys(records["LASF_Projection", 34735], texts)
    for user in ("LASF_Projection", "liblas"):
        wkt = records.get((user, 2112), b"").split(b"\0")[0].decode("utf-8", "replace").strip()
        if wkt:
            crs = parse_wkt(wkt)
            if keys is None:
                return crs
            return Crs(wkt, crs.unit or keys.unit, crs.height_unit or keys.height_unit)
    return keys
