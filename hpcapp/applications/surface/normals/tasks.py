"""The tasks that give a cloud normals, region by region; each is a pure function of its points.

::

    region ── estimate_region ──> normals without a side, as long as the noise
    region ── group_region ──> patches and links ──> master: their sides
    region ── turn_region ──> unit normals, each on its side
    region ── sum_region ──> facets, by which the shape of the whole is judged
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.cloud.patterns import region_bytes
from hpcapp.applications.surface.cloud.regions import RegionPoints, Replaced
from hpcapp.applications.surface.normals.estimation import estimate_normals, keep_directions
from hpcapp.applications.surface.normals.facets import Facets, gather_facets
from hpcapp.applications.surface.normals.patches import (
    Links,
    Patches,
    Sides,
    find_patches,
    turn_points,
)
from hpcapp.applications.surface.normals.patterns import (
    CONFIDENCE_BINS,
    Confidences,
    Sureness,
    estimated_region,
    grouped_region,
    summed_region,
    turned_region,
)
from hpcapp.geometry.points import FloatArray
from hpccomponent.runtime.tasks import declare


@declare(result=estimated_region, limit=region_bytes(40))
def estimate_region(
    points: RegionPoints, low: FloatArray, spacing: float, keeps: bool
) -> tuple[Replaced]:
    """Estimate the normals of a region by `estimation.estimate_normals` (a task).

    The points have a margin of `estimation.MARGIN` spacings; `keeps` says whether directions that
    are there stay, and only lengths are estimated.
    """
    region = points.take()
    vectors = estimate_normals(region.positions, region.own, low, spacing, region.threads)
    if keeps:
        vectors = keep_directions(vectors, region.normals[region.own])
    return (region.replace_normals(vectors),)


@declare(result=grouped_region, limit=region_bytes(1024))
def group_region(points: RegionPoints, low: FloatArray, spacing: float) -> tuple[Patches, Links]:
    """Find the patches of a region by `patches.find_patches` (a task).

    The points have estimated normals, and a margin of `patches.MARGIN` spacings.
    """
    region = points.take()
    given = region.positions, region.normals, region.own, low, spacing
    return find_patches(*given, region.threads)


@declare(result=turned_region, limit=region_bytes(40))
def turn_region(
    points: RegionPoints, low: FloatArray, spacing: float, sides: Sides, tells: bool
) -> tuple[Replaced, int, Confidences, Sureness]:
    """Turn the estimated normals of a region to their side by `patches.turn_points` (a task).

    The points have a margin of `patches.MARGIN` spacings; the sides are those of all patches. With
    the unit normals come how many are the opposites of what they were, the histogram of their
    confidences, and, where `tells` asks for it, that of each point.
    """
    region = points.take()
    found = turn_points(region.positions, region.normals, low, spacing, sides, region.threads)
    normals, is_turned, confidences = (
        found[0][region.own],
        found[1][region.own],
        found[2][region.own],
    )
    # (m,): the last bin holds a confidence of 1, too.
    bins = np.minimum((confidences * CONFIDENCE_BINS).astype(np.int64), CONFIDENCE_BINS - 1)
    counts = np.bincount(bins, minlength=CONFIDENCE_BINS)
    replaced = region.replace_normals(normals.astype(np.float64))
    told = confidences if tells else np.empty(0, np.float32)
    return replaced, int(np.count_nonzero(is_turned)), counts, told


@declare(result=summed_region, limit=region_bytes(400))
def sum_region(points: RegionPoints, low: FloatArray, edge: float) -> Facets:
    """Sum up the points of a region in cells (a task); see `facets.gather_facets`."""
    region = points.take()
    return gather_facets(region.positions, region.normals, low, edge)
