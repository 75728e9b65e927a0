"""What the tasks of a reconstruction declare of their results (see `hpccomponent.protocol`).

Names of extents: b blocks or bricks, c cells or components, g foreign vertices, s samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hpccomponent.protocol.declared import (
    Array,
    Declared,
    Each,
    Either,
    Exactly,
    Fixed,
    Flag,
    Nothing,
    Number,
    Where,
    Whole,
)
from hpccomponent.protocol.frames import DEFAULT_RESULT_BYTES

__all__ = [
    "BOX",
    "BOX_COUNTS",
    "CELL_COUNTS",
    "MENDED",
    "RANKS",
    "SAMPLE",
    "SMALL_BYTES",
    "STRAY_CELLS",
    "WRITTEN",
    "arranged_range",
    "bounded_range",
    "far_field",
    "range_bytes",
    "summed_tile",
    "surface_bytes",
    "surveyed_range",
    "tile_surface",
]

SMALL_BYTES = 1 << 16
"""Of results whose size does not depend on the points."""

_MOST = 1 << 40  # of whatever is counted where the master does not know better

_KEYS = Array("<i8", "b", low=0)
_COUNTS = Array("<i8", "b", low=0, high=_MOST)

BOX = Array("<f8", 2, 3, low=-np.inf, finite=False)  # inside out around no points
WRITTEN = Flag()
CELL_COUNTS = Fixed(Array("<i8", "c", low=0), Array("<i8", "c", low=1, high=_MOST))
BOX_COUNTS = Each(Fixed(Whole(0, _MOST), _KEYS))
SAMPLE = Fixed(Array("<f8", "s", 3), Array("<f8", "s", 3))
STRAY_CELLS = Array("<i8", "s", low=0)
RANKS = Fixed(
    Array("<i8", "ranks", low=0),
    Array("<i8", "coarse", low=0),
    Array("<i8", "coarse", low=0, high=_MOST),
    Array("<i8", "sparse", low=0),
    Array("<i8", "sparse", low=0, high=64),
    Array("<i8", "sparse", low=0, high=_MOST),
)


def _are_packed(values: Any) -> bool:
    return len(values) == 2 or int(values[1].sum()) == len(values[2])


MENDED = Fixed(
    Either(
        Nothing(),
        Fixed(_KEYS, _COUNTS),
        Where(
            Fixed(_KEYS, _COUNTS, Array("<f4", "p", 3), Array("<f4", "p", 3)),
            _are_packed,
            "there are not as many points as are counted",
        ),
    ),
    Whole(0, _MOST),
    Array("<f8", 2, "s", 3),
)


def count_range(points: Any) -> int:
    """Return how many points a range of a file holds (see `file_ranges.FilePoints`)."""
    return int(points[3] - points[2] if points[0] == "there" else len(points[2]))


def surveyed_range(points: Any, _before: int, _step: int) -> Declared:
    """Return the pattern of what `file_ranges.survey_range` finds."""
    some = Whole(0, count_range(points))
    return Fixed(some, some, some, BOX, BOX, Array("<f8", "s", 3))


def bounded_range(points: Any, *_: Any) -> Declared:
    """Return the pattern of what `file_ranges.bound_range` finds."""
    return Fixed(Whole(0, count_range(points)), BOX)


def arranged_range(
    points: Any, _origin: Any, _reach: Any, _arrangement: Any, _target: Any, boxes: Any
) -> Declared:
    """Return the pattern of what `file_ranges.arrange_range` writes."""
    most = count_range(points)
    counts = Array("<i8", "b", low=1, high=most)
    return Fixed(_KEYS, counts, Each(Fixed(Whole(0, most), _KEYS), len(boxes[1])))


def range_bytes(points: Any, *_: Any) -> int:
    """Return how large what is found in a range of a file may be, in bytes."""
    return SMALL_BYTES + 256 * count_range(points)


def far_field(nodes: int) -> Declared:
    """Return the pattern of a `FarFieldPart` with so many nodes along a side."""
    box, first = Array("<f4", "x", "y", "z"), Array("<i8", 3, low=0, high=nodes)
    return Where(
        Fixed(box, first, Exactly(nodes), Array("<f8", 3), Number(0.0)),
        lambda values: bool((values[1] + values[0].shape <= nodes).all()),
        "the box lies within the whole",
    )


def surface_bytes(work: float) -> int:
    """Return how large the surface of a tile of so much work may be, in bytes."""
    return DEFAULT_RESULT_BYTES + 4096 * int(work)


def summed_tile(
    _plan: Any, _points: Any, _ticket: Any = None, keep: tuple[str, str] | None = None, *_: Any
) -> Declared:
    """Return the pattern of what `region.sum_tile` returns, or keeps."""
    if keep is not None:
        place, name = keep
        return Fixed(Nothing(), Exactly((place, f"{name}-far")), Whole(0, _MOST))
    cells = Array("<i8", "c", low=0)
    lattice = Fixed(cells, Array("<f8", "c", "moments"), Array("<f8", "c"), Array("<i8", "v"))
    samples = Fixed(Array("<i8", "s", low=0), Array("<f8", "s", 7))
    return Fixed(lattice, samples, Whole(0, _MOST))


def tile_surface(keep: tuple[str, str] | None) -> Declared:
    """Return the pattern of what `region.mesh_tile` returns, or keeps."""
    return Fixed(_PART if keep is None else Nothing(), _SUMMARY, Array("<i8", "exits", low=0))


def _is_part(values: Any) -> bool:
    bricks, _, vertex_counts, face_counts, vertices, faces, foreign, _ = values
    return (
        _rise(bricks)
        and int(vertex_counts.sum(dtype=np.int64)) == len(vertices)
        and int(face_counts.sum(dtype=np.int64)) == len(faces)
        and _lie_within(faces, -len(foreign), len(vertices))
    )


def _is_summary(values: Any) -> bool:
    bricks, _, vertex_counts, _, foreign = values[:5]
    foreign_labels, starts, labels = values[6:9]
    mixed, bounds, piece_vertices, units = values[12:16]
    bare, seam_faces, rim = values[17:20]
    own, components = int(vertex_counts.sum(dtype=np.int64)), len(bounds)
    return (
        _rise(bricks)
        and int(starts[0]) == 0
        and int(starts[-1]) == len(labels)
        and bool((starts[1:] >= starts[:-1]).all())
        and all(_lie_within(of, 0, components) for of in (foreign_labels, labels, mixed))
        and _lie_within(units, -1, len(bricks))
        and all(
            _lie_within(of, -len(foreign), own)
            for of in (piece_vertices, bare, seam_faces[:, 1:], rim)
        )
    )


def _rise(keys: Any) -> bool:
    return bool((keys[1:] > keys[:-1]).all())


def _lie_within(rows: Any, low: int, end: int) -> bool:
    return not rows.size or bool(rows.min() >= low and rows.max() < end)


def _ints(*shape: int | str, low: int | None = 0) -> Array:
    return Array("<i4", *shape, low=low)


_BRICKS = (Array("<i8", "b", low=0), Array("|b1", "b"), _ints("b"), _ints("b"))
_FOREIGN = (Array("<i8", "g", low=0), _ints("g"))
_PART = Where(
    Fixed(*_BRICKS, Array("<f8", "v", 3), _ints("f", 3, low=None), *_FOREIGN),
    _is_part,
    "bricks rise, and have as many vertices and faces as they count",
)
_SUMMARY = Where(
    Fixed(
        *_BRICKS,
        *_FOREIGN,
        _ints("g"),
        _ints("b+1"),
        _ints("e"),
        _ints("e"),
        _ints("e"),
        Array("<f8", "e", 4),
        _ints("m"),
        Array("<f8", "c", 6, low=-np.inf, finite=False),  # infinite without vertices
        _ints("p", low=None),
        _ints("p", low=-1),
        _ints("q", 3),
        _ints("bare", low=None),
        _ints("seam", 4, low=None),
        _ints("r"),
        Array("<f8", "r", 3),
    ),
    _is_summary,
    "what it names lies among its bricks, vertices and components",
)
