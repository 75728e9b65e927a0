"""The octree of a COPC file: which of its chunks reach into a part of space.

Of the specification, https://copc.io, version 1.0: a record tells the cube and where the first page
of the hierarchy is; entries of pages are chunks, or further pages.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.regions.region import Area
from hpcapp.io.las.header import LasHeader
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_NAME = ("copc", 1)
_RECORD = struct.Struct("<4d8xQQ")
"""Middle and half of the edge of the cube; offset and size of the first page."""

_ENTRY = np.dtype(
    [("level", "<i4"), ("cell", "<i4", 3), ("at", "<u8"), ("size", "<i4"), ("points", "<i4")]
)
_DEEPEST = 31  # levels: cells are numbered with 32 bits
_A_PAGE = -1  # as a number of points


@dataclass(frozen=True, slots=True)
class Chunk:
    """Points of one node, compressed together; place and size are in bytes of the file."""

    at: int
    size: int
    points: int


def has_octree(header: LasHeader) -> bool:
    """Tell whether a file has one."""
    return len(header.records.get(_NAME, b"")) >= _RECORD.size


def find_chunks(path: Path, header: LasHeader, area: Area) -> list[Chunk]:
    """Return the chunks of the nodes that reach into a part of space, in the order of the file.

    Raise InputError where the octree is damaged.
    """
    entries = np.concatenate(list(_read_pages(path, header, area)))
    entries = np.sort(entries[entries["points"] > 0], order="at")
    ends = entries["at"] + entries["size"]
    if (entries["size"] <= 0).any() or (ends[:-1] > entries["at"][1:]).any():
        raise _damaged(path, "chunks overlap")
    if ends.max(initial=0) > path.stat().st_size or entries["points"].sum() > header.count:
        raise _damaged(path, "its nodes hold more than the file")
    return [Chunk(*row) for row in entries[["at", "size", "points"]].tolist()]


def _read_pages(path: Path, header: LasHeader, area: Area) -> Iterator[NDArray[np.void]]:
    """Yield the entries of pages that reach into a part of space, from the first page on."""
    *middle, half, at, size = _RECORD.unpack_from(header.records[_NAME])
    low, largest = np.array(middle) - half, path.stat().st_size
    waiting, seen = [(at, size)], 0
    with path.open("rb") as file:
        while waiting:
            at, size = waiting.pop()
            seen += size
            if not 0 < size <= largest - at or seen > largest:
                raise _damaged(path, "a page of it is beyond the file, or comes twice")
            file.seek(at)
            entries = np.frombuffer(file.read(size // _ENTRY.itemsize * _ENTRY.itemsize), _ENTRY)
            if not ((entries["level"] >= 0) & (entries["level"] <= _DEEPEST)).all():
                raise _damaged(path, "a level of it is none")
            edges = 2.0 * half / np.exp2(entries["level"])[:, None]
            lows = low + entries["cell"] * edges
            # Coordinates are rounded to whole steps, which may lead out of the cube.
            entries = entries[area.meets(lows - header.scales, lows + edges + header.scales)]
            yield entries
            pages = entries[entries["points"] == _A_PAGE]
            waiting += pages[["at", "size"]].tolist()


def _damaged(path: Path, why: str) -> InputError:
    return InputError(
        f"{path}: the octree is damaged: {why}", "copy or export it again, or leave the part out"
    )
