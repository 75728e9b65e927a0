"""Outliers of a cloud that is looked at region by region, and found just as in one piece.

::

    region + margin ── rank_region ──> points by rank, coarse cells, sparse cells,
                                       cells that are stray if a base is right
                              all of these ── judge_sparse ──> base, stray cells

What decides over a point of rank `LOCAL_RANK` or less lies within `MARGIN` spacings of it, so
that a region knows it; cells of higher ranks are few, and the master judges them with all coarse
cells. Cells are those of one lattice.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.cleaning.outliers import (
    EDGE,
    ISLAND_LEVEL,
    CellLevel,
    coarsen,
    find_base,
    find_islands,
    find_strays,
    rank_cells,
)
from hpcapp.applications.surface.types.result_patterns import CellCounts, CellKeys
from hpcapp.geometry.lattice import (
    cells_of,
    find_keys,
    merge_counts,
    number_keys,
    pack_places,
    unique_keys,
    unpack_keys,
)
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

LOCAL_RANK = ISLAND_LEVEL
"""Up to which a region judges by itself."""

MARGIN = EDGE * (4 * 2.0**LOCAL_RANK + 1)
"""Spacings: two cells to a neighbour's end, twice, for it is judged by its own neighbours."""


@record("surface.region_ranks")
@dataclass(frozen=True, slots=True, eq=False)
class RegionRanks:
    """Own points of a region by rank; c cells of `ISLAND_LEVEL`, s sparse ones."""

    by_rank: Annotated[IntArray, Column(LOCAL_RANK + 2, low=0)]
    """Points of each rank; the last are those of all higher ranks."""
    coarse_keys: CellKeys
    coarse_counts: CellCounts
    sparse_keys: Annotated[IntArray, Column("s", rises=True)]
    """Finest cells of rank `LOCAL_RANK` or more."""
    sparse_ranks: Annotated[IntArray, Column("s", low=LOCAL_RANK, high=LOCAL_RANK + 1)]
    sparse_counts: Annotated[IntArray, Column("s", low=1)]
    """Points in each."""
    stray_keys: Annotated[IntArray, Column("t", rises=True)]
    """Finest cells of rank `LOCAL_RANK` or less that some base makes strays."""
    stray_bases: Annotated[IntArray, Column("t", low=1, high=(1 << LOCAL_RANK) - 1)]
    """Which ones do: bit b is that of base b."""


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What the master finds: the rank of most points, and the stray cells.

    Those are sorted keys of finest cells (s,), and of cells of `ISLAND_LEVEL` on islands (i,).
    """

    base: int
    stray_cells: IntArray
    island_cells: IntArray


@record("surface.dropped_cells")
@dataclass(frozen=True, slots=True, eq=False)
class DroppedCells:
    """Cells whose points are outliers: `strays` of the finest, and `islands` of `ISLAND_LEVEL`.

    Both are sorted keys; the cells follow from the cloud's least coordinates `low` (3,) and
    `spacing`.
    """

    low: FloatArray
    spacing: float
    strays: IntArray
    islands: IntArray

    def find_kept(self, positions: FloatArray) -> BoolArray:
        """Tell which points, of shape (n, 3), do not lie in these cells."""
        edge = EDGE * self.spacing
        cells = np.floor(cells_of(positions, self.low, edge)).astype(np.int64)
        kept: BoolArray = find_keys(self.strays, pack_places(cells)) == len(self.strays)
        islands = pack_places(cells >> ISLAND_LEVEL)
        kept &= find_keys(self.islands, islands) == len(self.islands)
        return kept


def rank_region(
    positions: FloatArray, own: BoolArray, low: FloatArray, spacing: float
) -> RegionRanks:
    """Rank the points (n, 3) of the cloud in a region and within `MARGIN` spacings of it.

    `own` (n,) tells which lie in the region; `low` (3,) are the least coordinates of the cloud.
    """
    keys, held_by, cell_of = kernels.count_cells(positions, low, EDGE * spacing)
    levels = coarsen(keys, held_by, LOCAL_RANK + 1)
    rank = rank_cells(levels, np.zeros(len(keys), np.int64))
    counts = np.bincount(cell_of[own], minlength=len(rank)).astype(np.int64)
    by_rank = np.bincount(rank, counts, LOCAL_RANK + 2).astype(np.int64)
    level = levels[ISLAND_LEVEL]
    coarse = np.bincount(level.row_of, counts, len(level.keys)).astype(np.int64)
    # Of that rank, too: they vouch for those of the next one, which the master judges.
    some = np.flatnonzero((rank >= LOCAL_RANK) & (counts > 0))
    held = coarse > 0
    sparse = keys[some], rank[some], counts[some]
    # (f,): what is stray of low ranks, by each base that may be that of the cloud.
    bases = np.zeros(len(keys), np.int64)
    for base in range(LOCAL_RANK):
        stray = find_strays(levels, rank, base, range(base + 1, LOCAL_RANK + 1)) & (counts > 0)
        bases |= stray.astype(np.int64) << base
    strays = np.flatnonzero(bases)
    return RegionRanks(
        by_rank, level.keys[held], coarse[held], *sparse, keys[strays], bases[strays]
    )


def judge_sparse(regions: list[RegionRanks]) -> Judgement:
    """Judge the cells of high ranks, and the islands, and tell the strays of low ones."""

    def all_of(name: str) -> IntArray:
        return np.concatenate([getattr(ranks, name) for ranks in regions])

    coarse = merge_counts(all_of("coarse_keys"), all_of("coarse_counts"))
    coarse_levels = coarsen(*coarse)
    island = find_islands(coarse_levels)
    # (s,): the sparse cells of all regions, by key; a cell at a border is in several, in shares.
    keys, rows = number_keys(all_of("sparse_keys"))
    counts = np.bincount(rows, all_of("sparse_counts"), len(keys)).astype(np.int64)
    rank = np.empty(len(keys), np.int64)
    rank[rows] = all_of("sparse_ranks")
    by_rank = np.sum([ranks.by_rank for ranks in regions], axis=0)
    stray = np.zeros(len(keys), np.bool_)
    base = find_base(by_rank)
    if by_rank[-1]:
        levels = _levels_of(keys, counts, coarse_levels)
        rank = rank_cells(levels, rank)
        # Points by rank: up to `LOCAL_RANK` as regions have counted them, above as ranked here.
        high = np.bincount(rank, np.where(rank > LOCAL_RANK, counts, 0)).astype(np.int64)
        by_rank = np.concatenate([by_rank[:-1], high[LOCAL_RANK + 1 :]])
        base = find_base(by_rank)
        numbers = range(max(base, LOCAL_RANK) + 1, len(levels))
        stray = find_strays(levels, rank, base, numbers)
    low = all_of("stray_keys")[all_of("stray_bases") >> base & 1 > 0]
    return Judgement(base, unique_keys(np.concatenate([keys[stray], low])), coarse[0][island])


def _levels_of(keys: IntArray, counts: IntArray, coarse: list[CellLevel]) -> list[CellLevel]:
    """Return the levels above some finest cells; those below `ISLAND_LEVEL` know only these."""
    levels = coarsen(keys, counts, ISLAND_LEVEL)
    places = unpack_keys(keys)
    for number, level in enumerate(coarse, start=ISLAND_LEVEL):
        rows = find_keys(level.keys, pack_places(places >> number))
        levels.append(CellLevel(level.keys, level.counts, rows))
    return levels
