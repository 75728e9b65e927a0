"""The tasks that give a cloud normals, region by region; each is a pure function of its points.

::

    region ── estimate_blocks ──> folder: normals without a side, as long as the noise
    region ── group_blocks ──> patches and links ──> master: their sides
    region ── turn_blocks ──> folder: unit normals, each on its side
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpccomponent.runtime.tasks import declare
from hpccomponent.surface.cloud.arrangement import PackedPoints
from hpccomponent.surface.cloud.disk import write_part
from hpccomponent.surface.cloud.regions import RegionPoints, take_region
from hpccomponent.surface.normals.estimation import estimate_normals, keep_directions
from hpccomponent.surface.normals.patches import (
    Links,
    Patches,
    Sides,
    find_patches,
    turn_points,
)
from hpccomponent.surface.tasks.cloud_patterns import (
    CONFIDENCE_BINS,
    estimated_region,
    grouped_region,
    region_bytes,
    turned_region,
)
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = ["CONFIDENCE_BINS", "Replaced", "estimate_blocks", "group_blocks", "turn_blocks"]

Replaced = PackedPoints | tuple[IntArray, IntArray]
"""The points of a region, or if they were written only their keys and counts."""

Target = tuple[str, int] | None
"""The folder, and the number of the part (see `disk.write_part`); None where the worker does not
see it."""


@declare(result=estimated_region, limit=region_bytes(40))
def estimate_blocks(
    points: RegionPoints, low: FloatArray, spacing: float, keeps: bool, target: Target
) -> Replaced:
    """Estimate the normals of a region (a task).

    Parameters
    ----------
    points : tuple
        `RegionPoints`, with a margin of `estimation.MARGIN` spacings.
    low, spacing
        As for `estimation.estimate_normals`.
    keeps : bool
        Whether the directions that are there stay, and only lengths are estimated.
    target : tuple of (str, int), or None
        See `Target`.

    Returns
    -------
    PackedPoints or tuple
        See `Replaced`; with normals as `estimate_normals` returns them.

    Raises
    ------
    OutputError
        The disk is full, or the folder cannot be written.
    """
    region = take_region(points)
    vectors = estimate_normals(region.positions, region.own, low, spacing)
    if keeps:
        vectors = keep_directions(vectors, region.normals[region.own])
    return _put(region.pack_with(vectors), target)


@declare(result=grouped_region, limit=region_bytes(1024))
def group_blocks(points: RegionPoints, low: FloatArray, spacing: float) -> tuple[Patches, Links]:
    """Find the patches of a region (a task); see `patches.find_patches`.

    Parameters
    ----------
    points : tuple
        `RegionPoints`, with a margin of `patches.MARGIN` spacings, of a cloud with estimated
        normals.
    low, spacing
        As for `find_patches`, whose result this is.

    Returns
    -------
    patches : Patches
    links : Links
    """
    region = take_region(points)
    return find_patches(region.positions, region.normals, region.own, low, spacing)


@declare(result=turned_region, limit=region_bytes(40))
def turn_blocks(
    points: RegionPoints, low: FloatArray, spacing: float, sides: Sides, target: Target
) -> tuple[Replaced, int, IntArray]:
    """Turn the normals of a region to their side (a task); see `patches.turn_points`.

    Parameters
    ----------
    points : tuple
        `RegionPoints`, with a margin of `patches.MARGIN` spacings, of a cloud with estimated
        normals.
    low, spacing, sides
        As for `turn_points`.
    target : tuple of (str, int), or None
        See `Target`.

    Returns
    -------
    replaced : PackedPoints or tuple
        See `Replaced`; with unit normals.
    turned : int
        How many of these are the opposites of what they were.
    confidences : ndarray of int64, shape (100,)
        How many points have a confidence of 0 to 0.01, 0.01 to 0.02 ...

    Raises
    ------
    OutputError
        The disk is full, or the folder cannot be written.
    """
    region = take_region(points)
    normals, is_turned, confidences = turn_points(
        region.positions, region.normals, low, spacing, sides
    )
    own = region.own
    bins = np.minimum((confidences[own] * CONFIDENCE_BINS).astype(np.int64), CONFIDENCE_BINS - 1)
    counts = np.bincount(bins, minlength=CONFIDENCE_BINS)
    turned = int(np.count_nonzero(is_turned[own]))
    return _put(region.pack_with(normals[own]), target), turned, counts


def _put(packed: PackedPoints, target: Target) -> Replaced:
    return packed if target is None else write_part(Path(target[0]), target[1], [packed])
