"""What a page is told of the file that it shows, to write the command that cuts it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.pages.arrays import Packable
from hpccomponent.dataclass import dataclass

MOST_PIECES = 1000
"""Pieces that a page can keep; all smaller ones are dropped together."""


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """The connected pieces of a mesh: the rank (v,) of each vertex's piece, 0 for the largest.

    `areas` (p,) are in the order of ranks; `suggested` is how many are not small.
    """

    ranks: IntArray
    areas: FloatArray
    suggested: int


@dataclass(frozen=True, slots=True, eq=False)
class Cutting:
    """Commands that cut a file, without what is to be kept.

    Parameters
    ----------
    commands : mapping of str to str
        By what they make; words are quoted as a shell reads them.
    bounds : ndarray of float64, shape (2, 3)
        Of all that the file holds, in the frame of the scene: of many points a page shows a part.
    polygon : str
        Name of the GeoJSON that a drawn polygon is saved as; the shell's word is the same.
    crs : mapping or None
        The member of the GeoJSON that names its coordinate reference system.
    pieces : Pieces or None
        Of a mesh that has more than one.
    """

    commands: Mapping[str, str]
    bounds: FloatArray
    polygon: str
    crs: Mapping[str, object] | None = None
    pieces: Pieces | None = None


def pack_cutting(cutting: Cutting, pack: Callable[[Packable], str]) -> dict[str, object]:
    """Return what the program of a page is told, as JSON values."""
    pieces = cutting.pieces
    low, high = cutting.bounds.tolist()
    return {
        "low": low,
        "high": high,
        "commands": [{"label": label, "text": text} for label, text in cutting.commands.items()],
        "polygon": cutting.polygon,
        "crs": cutting.crs,
        "pieces": None if pieces is None else _pack_pieces(pieces, pack),
    }


def _pack_pieces(pieces: Pieces, pack: Callable[[Packable], str]) -> dict[str, object]:
    """Pack the ranks, and which share of the area the largest pieces have together."""
    shares = np.cumsum(pieces.areas) / (float(pieces.areas.sum()) or 1.0)
    return {
        "ranks": pack(np.minimum(pieces.ranks, MOST_PIECES).astype(np.uint16)),
        "shares": [round(share, 6) for share in shares[:MOST_PIECES].tolist()],
        "count": len(pieces.areas),
        "suggested": min(pieces.suggested, MOST_PIECES),
    }
