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
    Record,
    Where,
    Whole,
)
from hpccomponent.protocol.frames import DEFAULT_RESULT_BYTES
from hpccomponent.surface.cloud.arrangement import PackedPoints
from hpccomponent.surface.extraction.opening import OpeningSeams
from hpccomponent.surface.extraction.parts import MeshPart
from hpccomponent.surface.extraction.summary import PartSummary
from hpccomponent.surface.fitting.far_field import FarFieldPart
from hpccomponent.surface.normals.patches import Links, Patches
from hpccomponent.surface.tiles.plan import CoarseLattice, Samples

__all__ = [
    "BOX",
    "BOX_COUNTS",
    "CELL_COUNTS",
    "MENDED",
    "OPENING_SEAMS",
    "PATCHES",
    "RANKS",
    "REPEATED",
    "REPLACED",
    "SAMPLE",
    "SMALL_BYTES",
    "STRAY_CELLS",
    "SUPPORTED",
    "TURNED",
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
REPEATED = Fixed(Whole(0, _MOST), _KEYS, _COUNTS)
RANKS = Fixed(
    Array("<i8", "ranks", low=0),
    Array("<i8", "coarse", low=0),
    Array("<i8", "coarse", low=0, high=_MOST),
    Array("<i8", "sparse", low=0),
    Array("<i8", "sparse", low=0, high=64),
    Array("<i8", "sparse", low=0, high=_MOST),
)


_PACKED = Where(
    Record(
        PackedPoints,
        keys=_KEYS,
        counts=_COUNTS,
        offsets=Array("<f4", "p", 3),
        normals=Array("<f4", "p", 3),
    ),
    lambda packed: int(packed.counts.sum()) == len(packed),
    "there are not as many points as are counted",
)
REPLACED = Either(Fixed(_KEYS, _COUNTS), _PACKED)
TURNED = Fixed(REPLACED, Whole(0, _MOST), Array("<i8", 100, low=0, high=_MOST))
PATCHES = Where(
    Fixed(
        Record(
            Patches,
            keys=Array("<i8", "p", low=0),
            ranks=Array("<i8", "p", low=0, high=64),
            counts=Array("<i8", "p", low=1, high=_MOST),
            centres=Array("<f8", "p", 3),
            normals=Array("<f8", "p", 3),
            noise=Array("<f8", "p", low=0.0),
        ),
        Record(
            Links,
            first=Array("<i8", "l", low=0),
            second=Array("<i8", "l", low=0),
            contacts=Array("<i8", "l", low=1, high=_MOST),
        ),
    ),
    lambda found: int(found[1].second.max(initial=-1)) < len(found[0]),
    "a link is to no patch",
)
MENDED = Fixed(
    Either(
        Nothing(),
        Fixed(_KEYS, _COUNTS),
        _PACKED,
    ),
    Whole(0, _MOST),
    Array("<f8", 2, "s", 3),
)


def count_range(points: Any) -> int:
    """Return how many points a range of a file holds (see `file_ranges.FilePoints`).

    Parameters
    ----------
    points : FileRange or SentRange

    Returns
    -------
    int
    """
    return len(points)


def surveyed_range(points: Any, _before: int, _step: int) -> Declared:
    """Return the pattern of what `file_ranges.survey_range` finds.

    Parameters
    ----------
    points : FileRange or SentRange
    _before, _step : int
        Not looked at.

    Returns
    -------
    Declared
    """
    some = Whole(0, count_range(points))
    return Fixed(some, some, some, BOX, BOX, Array("<f8", "s", 3))


def bounded_range(points: Any, *_: Any) -> Declared:
    """Return the pattern of what `file_ranges.bound_range` finds.

    Parameters
    ----------
    points : FileRange or SentRange
    *_ : object
        Not looked at.

    Returns
    -------
    Declared
    """
    return Fixed(Whole(0, count_range(points)), BOX)


def arranged_range(
    points: Any, _origin: Any, _reach: Any, _arrangement: Any, _target: Any, boxes: Any
) -> Declared:
    """Return the pattern of what `file_ranges.arrange_range` writes.

    Parameters
    ----------
    points : FileRange or SentRange
    _origin, _reach, _arrangement, _target : object
        Not looked at.
    boxes : tuple
        As `arrange_range` is given them.

    Returns
    -------
    Declared
    """
    most = count_range(points)
    counts = Array("<i8", "b", low=1, high=most)
    return Fixed(_KEYS, counts, Each(Fixed(Whole(0, most), _KEYS), len(boxes[1])))


def range_bytes(points: Any, *_: Any) -> int:
    """Return how large what is found in a range of a file may be.

    Parameters
    ----------
    points : FileRange or SentRange
    *_ : object
        Not looked at.

    Returns
    -------
    int
        In bytes.
    """
    return SMALL_BYTES + 256 * count_range(points)


def far_field(nodes: int) -> Declared:
    """Return the pattern of a `FarFieldPart` with so many nodes along a side.

    Parameters
    ----------
    nodes : int

    Returns
    -------
    Declared
    """
    box, first = Array("<f4", "x", "y", "z"), Array("<i8", 3, low=0, high=nodes)
    return Where(
        Record(
            FarFieldPart,
            values=box,
            first=first,
            nodes=Exactly(nodes),
            origin=Array("<f8", 3),
            step=Number(0.0),
        ),
        lambda part: bool((part.first + part.values.shape <= nodes).all()),
        "the box lies within the whole",
    )


def surface_bytes(work: float) -> int:
    """Return how large the surface of a tile of so much work may be.

    Parameters
    ----------
    work : float
        See `points.estimate_work`.

    Returns
    -------
    int
        In bytes.
    """
    return DEFAULT_RESULT_BYTES + 4096 * int(work)


def summed_tile(
    _plan: Any, _points: Any, _ticket: Any = None, keep: tuple[str, str] | None = None, *_: Any
) -> Declared:
    """Return the pattern of what `tiles.sum_tile` returns, or keeps.

    Parameters
    ----------
    _plan, _points, _ticket : object, optional
        Not looked at.
    keep : tuple of str, optional
        A store and a name, where it is kept.
    *_ : object
        Not looked at.

    Returns
    -------
    Declared
    """
    if keep is not None:
        place, name = keep
        return Fixed(Nothing(), Exactly((place, f"{name}-far")), Whole(0, _MOST))
    cells = Array("<i8", "c", low=0)
    lattice = Record(
        CoarseLattice,
        cells=cells,
        moments=Array("<f8", "c", "moments"),
        squares=Array("<f8", "c"),
        vertices=Array("<i8", "v"),
    )
    samples = Record(Samples, cells=Array("<i8", "s", low=0), sums=Array("<f8", "s", 7))
    return Fixed(lattice, samples, Whole(0, _MOST))


def tile_surface(keep: tuple[str, str] | None) -> Declared:
    """Return the pattern of what `tiles.mesh_tile` returns, or keeps.

    Parameters
    ----------
    keep : tuple of str or None
        A store and a name, where it is kept.

    Returns
    -------
    Declared
    """
    return Fixed(_PART if keep is None else Nothing(), _SUMMARY, Array("<i8", "exits", low=0))


def _is_part(part: MeshPart) -> bool:
    return (
        _rise(part.bricks)
        and int(part.vertex_counts.sum(dtype=np.int64)) == len(part.vertices)
        and int(part.face_counts.sum(dtype=np.int64)) == len(part.faces)
        and _lie_within(part.faces, -len(part.foreign_bricks), len(part.vertices))
    )


def _is_summary(part: PartSummary) -> bool:
    starts, labels = part.entry_starts, part.entry_labels
    own, components = int(part.vertex_counts.sum(dtype=np.int64)), len(part.bounds)
    return (
        _rise(part.bricks)
        and int(starts[0]) == 0
        and int(starts[-1]) == len(labels)
        and bool((starts[1:] >= starts[:-1]).all())
        and all(
            _lie_within(of, 0, components)
            for of in (part.foreign_labels, labels, part.mixed_labels)
        )
        and _lie_within(part.piece_units, -1, len(part.bricks))
        and all(
            _lie_within(of, -len(part.foreign_bricks), own)
            for of in (part.piece_vertices, part.bare, part.seam_faces[:, 1:], part.rim)
        )
    )


def _rise(keys: Any) -> bool:
    return bool((keys[1:] > keys[:-1]).all())


def _lie_within(rows: Any, low: int, end: int) -> bool:
    return not rows.size or bool(rows.min() >= low and rows.max() < end)


def _ints(*shape: int | str, low: int | None = 0) -> Array:
    return Array("<i4", *shape, low=low)


_BRICKS: dict[str, Declared] = {
    "bricks": Array("<i8", "b", low=0),
    "guests": Array("|b1", "b"),
    "vertex_counts": _ints("b"),
    "face_counts": _ints("b"),
    "foreign_bricks": Array("<i8", "g", low=0),
    "foreign_numbers": _ints("g"),
}
_PART = Where(
    Record(
        MeshPart,
        **_BRICKS,
        vertices=Array("<f8", "v", 3),
        faces=_ints("f", 3, low=None),
        supported=Array("|b1", "v"),
    ),
    _is_part,
    "bricks rise, and have as many vertices and faces as they count",
)
_SUMMARY = Where(
    Record(
        PartSummary,
        **_BRICKS,
        foreign_labels=_ints("g"),
        entry_starts=_ints("b+1"),
        entry_labels=_ints("e"),
        entry_vertices=_ints("e"),
        entry_faces=_ints("e"),
        entry_sums=Array("<f8", "e", 4),
        entry_supports=_ints("e"),
        mixed_labels=_ints("m"),
        bounds=Array("<f8", "c", 6, low=-np.inf, finite=False),  # infinite without vertices
        piece_vertices=_ints("p", low=None),
        piece_units=_ints("p", low=-1),
        sides=_ints("q", 3),
        bare=_ints("bare", low=None),
        seam_faces=_ints("seam", 4, low=None),
        rim=_ints("r"),
        rim_places=Array("<f8", "r", 3),
    ),
    _is_summary,
    "what it names lies among its bricks, vertices and components",
)
SUPPORTED = Fixed(Whole(0, _MOST), Whole(0, _MOST))
OPENING_SEAMS = Fixed(
    Nothing(),  # only what is kept is surveyed by others
    Record(
        OpeningSeams,
        foreign_bricks=Array("<i8", "g", low=0),
        foreign_numbers=_ints("g"),
        foreign_labels=_ints("g", low=-1),
        rim_labels=_ints("r", low=-1),
        rim_numbers=_ints("r", low=-1),
        loops=Array("<f8", "c", 6, low=-np.inf, finite=False),
        edges=Array("<i8", "m", 6, low=0),
    ),
)
