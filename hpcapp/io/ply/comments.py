"""What a PLY has no place for, kept in comments of its header.

::

    comment unit m
    comment height_unit ft              where heights have another one
    comment crs EPSG:2180
    comment joined 2 files: E57         what the points were read from
    comment sampled 100000              points on the faces of meshes, unasked
    comment scanner 0 1.5 2 0.25        the number of the scan, and where its scanner stood
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.crs import Crs
from hpcapp.io.points.point_source import Scan
from hpcapp.io.rows import is_count
from hpccomponent.dataclass import dataclass
from hpccomponent.ranges import is_place


@dataclass(slots=True, eq=False)
class Kept:
    """What comments say of a file's points; where the scanners stood, by the number of the scan.

    Files that were joined are named by their number and formats.
    """

    unit: str | None = None
    height_unit: str | None = None
    crs: str | None = None
    joined: str | None = None
    sampled: int = 0
    scanners: dict[int, FloatArray] = field(default_factory=dict)


def keep(crs: Crs, scans: Sequence[Scan] = (), sampled: int = 0) -> Iterator[str]:
    """Yield the comment lines that keep what is known of some points; scans in order."""
    if sampled:
        yield f"comment sampled {sampled}"
    for name, value in crs.stated.items():
        yield f"comment {name} {value}"
    for number, scan in enumerate(scans):
        if scan.scanner is not None:
            yield "comment scanner {} {!r} {!r} {!r}".format(number, *scan.scanner.tolist())


def parse_comments(comments: Sequence[Sequence[str]]) -> Kept:
    """Find what `keep` has written in the words behind each ``comment``; others are passed over."""
    kept = Kept()
    for words in comments:
        match words:
            case ["unit", *rest] if 0 < len(rest) < 3:
                kept.unit = " ".join(rest)
            case ["height_unit", *rest] if 0 < len(rest) < 3:
                kept.height_unit = " ".join(rest)
            case ["joined", *rest] if rest:
                kept.joined = " ".join(rest)
            case ["sampled", number] if number.isdecimal():
                kept.sampled = int(number)
            case ["crs", *rest] if rest:
                kept.crs = " ".join(rest)
            case ["scanner", number, *place] if is_count(number) and len(place) == 3:
                try:
                    scanner = np.array(place, np.float64)
                except ValueError:
                    continue
                if is_place(*scanner):
                    kept.scanners[int(number)] = scanner
    return kept
