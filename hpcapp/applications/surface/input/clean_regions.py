"""A cloud that is not in memory is cleaned region by region, to the same points as in memory.

::

    regions ── clean ── no sparse cells ── mended normals, sample ─────────────────> folder
                 │ sparse cells                                                       ^
                 └──> judge the few ── judge ──> stray cells ── spacing anew ── mend ─┘

Each region is read with a margin, some thirty spacings wide, and its task is a pure function of
these points. The points are read once for each of these steps, so that a region without sparse
cells is read once. Should points of others be dropped, what it was mended for was in vain.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.applications.surface.hierarchical.tiles import cut_tiles
from hpcapp.applications.surface.input.clean import Cleaned
from hpcapp.applications.surface.scans import Boxes, Passes, measure_spacing
from hpccomponent.surface.cloud import outlier_regions
from hpccomponent.surface.cloud.disk import DiskCloud, Part, write_index, write_part
from hpccomponent.surface.cloud.measured import (
    SAMPLED_BOX,
    Measured,
    Points,
    draw_sample,
    first_share,
)
from hpccomponent.surface.cloud.outlier_regions import RegionRanks, judge_sparse
from hpccomponent.surface.cloud.regions import DroppedCells
from hpccomponent.surface.normals import consistency as normals
from hpccomponent.surface.tasks.blocks import sample_blocks, survey_blocks
from hpccomponent.surface.tasks.cleaning import (
    MARGIN,
    clean_blocks,
    drop_repeated_points,
    judge_blocks,
    mend_blocks,
)
from hpccomponent.surface.types.lattice import pack_places, unique_keys
from hpccomponent.surface.types.points import FloatArray, IntArray, PointCloud

__all__ = ["clean_regions", "cut_regions", "drop_repeated_there", "measure_cloud"]

Mended = tuple[Part | None, int, FloatArray]
"""Of a region: what was written of it, if it changes, its flipped normals, and its sample."""


def drop_repeated_there(cloud: DiskCloud, folder: Path, passes: Passes) -> tuple[DiskCloud, int]:
    """Do to a cloud in a folder what `clean.drop_repeated` does to one in memory.

    Parameters
    ----------
    cloud : DiskCloud
    folder : Path
        Where the result is put: exists, and holds no other cloud. What does not change stays
        where it is.
    passes : Passes
        The result does not depend on it.

    Returns
    -------
    cloud : DiskCloud
        The first point of each place, in their order; the input itself where there are no others.
    repeated : int
        How many were dropped.

    Raises
    ------
    OutputError
        The disk is full, or the folder cannot be written.
    """
    runs = [cloud.keys[run] for run in passes.cut_blocks(cloud.counts)]
    asked = [(str(cloud.folder), keys, (str(folder), i)) for i, keys in enumerate(runs)]
    found = passes.map(drop_repeated_points, asked)
    repeated = sum(dropped for dropped, _, _ in found)
    if not repeated:
        return cloud, 0
    changed = [Part.whole(i, *written) for i, (_, *written) in enumerate(found)]
    gone = np.sort(np.concatenate([part.keys for part in changed]))
    parts = _without(cloud, gone, folder) + [part for part in changed if len(part.keys)]
    box = cloud.low, cloud.high
    return write_index(folder, cloud.arrangement, cloud.origin, box, parts), repeated


def clean_regions(
    cloud: DiskCloud, folder: Path, passes: Passes, boxes: Boxes | None = None
) -> tuple[DiskCloud, Cleaned]:
    """Do to a cloud in a folder what `cleaning.clean_cloud` does to one in memory.

    Parameters
    ----------
    cloud : DiskCloud
        Ten points or more.
    folder : Path
        Where the result is put: exists, and holds no other cloud. What does not change stays
        where it is.
    passes : Passes
        The result does not depend on it.
    boxes : Boxes, optional
        What has been counted of the cloud.

    Returns
    -------
    cloud : DiskCloud
        The points that remain, bit for bit those that remain in memory; measured.
    cleaned : Cleaned

    Raises
    ------
    InputError
        All points are the same.
    OutputError
        The disk is full, or the folder cannot be written.
    """
    regions = cut_regions(cloud.keys, cloud.counts, passes.count_pieces(len(cloud)))
    box = len(cloud), cloud.low, cloud.high
    spacing = measure_spacing(cloud, passes, box, None, boxes)
    ranks, mended = _clean(cloud, regions, folder, passes, spacing)
    dropped = _find_outliers(cloud, regions, spacing, passes, ranks)
    if dropped is not None:
        box, mended = _survey(cloud, passes, dropped), {}
        spacing = measure_spacing(cloud, passes, box, dropped)
    left = [region for region in range(len(regions)) if region not in mended]
    mended |= _mend(cloud, regions, folder, passes, left, (box[0], box[1], spacing), dropped)
    parts, flipped, sample = _put_together(cloud, regions, folder, mended)
    cleaned = write_index(folder, cloud.arrangement, cloud.origin, box[1:], parts)
    cleaned = measure_cloud(cleaned, passes, spacing, sample)
    return cleaned, Cleaned(len(cloud) - box[0], flipped)


def measure_cloud(
    cloud: DiskCloud, passes: Passes, spacing: float, sample: Points | None = None
) -> DiskCloud:
    """Note in a cloud's index what the method asks for: its spacing, and a sample of its points.

    Parameters
    ----------
    cloud : DiskCloud
    passes : Passes
    spacing : float
        In length units of the input.
    sample : Points, optional
        The first that `measured.draw_sample` asks for, in any order of blocks.

    Returns
    -------
    DiskCloud
        The same points, in the same folder.
    """

    def draw(one_in: int) -> Points:
        if sample is not None and one_in == first_share(len(cloud)):
            return _sort(cloud, sample)
        found = passes.map_blocks(
            sample_blocks, cloud, None, cloud.low, SAMPLED_BOX * spacing, one_in
        )
        positions, directions = (np.concatenate(column) for column in zip(*found, strict=True))
        return positions, directions

    measured = Measured(spacing, PointCloud(*draw_sample(draw, len(cloud))))
    box = cloud.low, cloud.high
    return write_index(cloud.folder, cloud.arrangement, cloud.origin, box, cloud.parts, measured)


def cut_regions(keys: IntArray, counts: IntArray, pieces: int) -> list[IntArray]:
    """Cut a cloud into regions of about as many points, as compact as blocks allow.

    Parameters
    ----------
    keys, counts : ndarray of int64, shape (b,)
        Of the cloud's blocks.
    pieces : int
        How many, or fewer.

    Returns
    -------
    list of ndarray of int64
        Sorted keys of each region's blocks.
    """
    region_of = cut_tiles(keys, counts, pieces)
    return [keys[region_of == region] for region in range(int(region_of.max()) + 1)]


def _clean(
    cloud: DiskCloud, regions: list[IntArray], folder: Path, passes: Passes, spacing: float
) -> tuple[list[RegionRanks], dict[int, Mended]]:
    """Rank the points of each region, and mend those of which none can be dropped."""
    more = _say_how(len(cloud), cloud.low, spacing, folder, passes)
    ranks: dict[int, RegionRanks] = {}
    mended: dict[int, Mended] = {}
    margin = MARGIN * spacing
    for region, found in passes.map_regions(clean_blocks, cloud, regions, margin, None, more):
        ranks[region], result = found
        if result is not None:
            mended[region] = _keep(result, region, folder, passes)
    return [ranks[region] for region in range(len(regions))], mended


def _find_outliers(
    cloud: DiskCloud,
    regions: list[IntArray],
    spacing: float,
    passes: Passes,
    ranks: list[RegionRanks],
) -> DroppedCells | None:
    """Return the cells whose points are outliers; nothing where there are none."""
    judged = judge_sparse(ranks)
    margin = outlier_regions.MARGIN * spacing
    common = cloud.low, spacing
    asked = [blocks for i, blocks in enumerate(regions) if ranks[i][0][judged.base + 1 : -1].any()]
    more = (*common, judged.base)
    rest = passes.map_regions(judge_blocks, cloud, asked, margin, None, lambda _: more)
    strays = unique_keys(np.concatenate([judged.stray_cells, *(cells for _, cells in rest)]))
    if not (len(strays) or len(judged.island_cells)):
        return None
    return DroppedCells(*common, strays, judged.island_cells)


def _survey(
    cloud: DiskCloud, passes: Passes, dropped: DroppedCells | None
) -> tuple[int, FloatArray, FloatArray]:
    """Count and bound the points that are left."""
    found = passes.map_blocks(survey_blocks, cloud, dropped)
    boxes = np.stack([box for _, box in found])
    return sum(count for count, _ in found), boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)


def _mend(
    cloud: DiskCloud,
    regions: list[IntArray],
    folder: Path,
    passes: Passes,
    asked: list[int],
    known: tuple[int, FloatArray, float],
    dropped: DroppedCells | None,
) -> Iterator[tuple[int, Mended]]:
    """Mend some regions, and yield what came of each; what changes is written."""
    # A worker that is late must not write in a later one's place.
    numbers = [region + (len(regions) if dropped is not None else 0) for region in asked]
    how = _say_how(*known, folder, passes)
    margin = normals.MARGIN * known[2]
    blocks = [regions[region] for region in asked]
    for index, result in passes.map_regions(
        mend_blocks, cloud, blocks, margin, dropped, lambda i: how(numbers[i])
    ):
        yield asked[index], _keep(result, numbers[index], folder, passes)


def _say_how(
    points: int, low: FloatArray, spacing: float, folder: Path, passes: Passes
) -> Callable[[int], tuple[Any, ...]]:
    """Return what tells, by the number of its part, what a task that mends is given."""
    sampled = SAMPLED_BOX * spacing, max(first_share(points), 1)

    def tell(number: int) -> tuple[Any, ...]:
        return low, spacing, (str(folder), number) if passes.workers_see else None, sampled

    return tell


def _keep(result: tuple[Any, ...], number: int, folder: Path, passes: Passes) -> Mended:
    """Take what a task that mends has returned; its points are written if it could not."""
    packed, turned, sample = result
    if packed is None:
        return None, turned, sample
    if not passes.workers_see:
        packed = write_part(folder, number, [packed])
    return Part.whole(number, *packed), turned, sample


def _put_together(
    cloud: DiskCloud, regions: list[IntArray], folder: Path, mended: dict[int, Mended]
) -> tuple[list[Part], int, Points]:
    """Return the parts of the cloud that is left, how many normals were flipped, and a sample."""
    changed = {i: part for i, (part, _, _) in sorted(mended.items()) if part is not None}
    old = np.sort(np.concatenate([np.zeros(0, np.int64), *(regions[i] for i in changed)]))
    parts = _without(cloud, old, folder) + list(changed.values())
    flipped = sum(turned for _, turned, _ in mended.values())
    positions, directions = np.concatenate([mended[i][2] for i in sorted(mended)], axis=1)
    return parts, flipped, (positions, directions)


def _without(cloud: DiskCloud, blocks: IntArray, folder: Path) -> list[Part]:
    """Return the parts of a cloud without some blocks, as they are seen from another folder."""
    there = os.path.relpath(cloud.folder, folder)
    parts = [part.without(blocks, there) for part in cloud.parts]
    return [part for part in parts if len(part.keys)]


def _sort(cloud: DiskCloud, sample: Points) -> Points:
    """Bring points, in order within each block, into the order of the cloud."""
    positions, directions = sample
    blocks = cloud.arrangement
    places = np.floor((positions - blocks.origin) / blocks.edge).astype(np.int64)
    order = np.argsort(pack_places(places), kind="stable")
    return positions[order], directions[order]
