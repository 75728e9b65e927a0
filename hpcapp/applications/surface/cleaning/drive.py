"""How a cloud is cleaned: far, repeated and stray points dropped, wrong normals flipped.

::

    drop_far ── drop_repeated ── outliers dropped ── strays dropped ── (normals) ── normals mended
                                        ▲                  │
                                        └──── once more ───┘

Outliers lie far from every surface (see `outliers`), strays near one (see `strays`). Where some are
gone, fewer are left that could vouch for the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcapp.applications.surface.cleaning import outlier_regions
from hpcapp.applications.surface.cleaning import tasks as tasks
from hpcapp.applications.surface.cleaning.outlier_regions import DroppedCells
from hpcapp.applications.surface.cleaning.strays import MARGIN, ROUNDS
from hpcapp.applications.surface.cloud.cloud_pass import CloudPass, PassT
from hpcapp.applications.surface.cloud.measure import measure_scale, measure_spacing
from hpcapp.applications.surface.normals import consistency
from hpcapp.applications.surface.types.lattice import lay_lattice, unique_keys

__all__ = [
    "Cleaned",
    "drop_repeated",
    "drop_strays",
    "mend_normals",
]


_MANY = 0.001  # of the points are strays: only then they have vouched for others


@dataclass(frozen=True, slots=True)
class Cleaned:
    """What was found wrong with a cloud.

    Parameters
    ----------
    outliers : int
        Points that were dropped because they lie far from every surface.
    strays : int
        Points that were dropped although they lie near one.
    flipped : int
        Normals that were turned round.
    repeated : int
        Points at the place of another that were dropped.
    """

    outliers: int = 0
    strays: int = 0
    flipped: int = 0
    repeated: int = 0


def drop_repeated(cloud_pass: PassT) -> tuple[PassT, int]:
    """Drop the points at the place of another, and return how many they were.

    The first point of each place stays.
    """
    cloud_pass, counts = cloud_pass.rewrite(tasks.drop_repeated)
    return cloud_pass, sum(count for (count,) in counts)


def drop_strays(cloud_pass: PassT, spacing: float) -> tuple[PassT, Cleaned, float]:
    """Drop the points that belong to no surface; normals are not asked.

    Parameters
    ----------
    cloud_pass : CloudPass
        Through ten points or more. Far ones must have been dropped: see `drop_far`.
    spacing : float
        In length units of the input.

    Returns
    -------
    cloud_pass : CloudPass
        Through the points that remain, in their order.
    cleaned : Cleaned
    spacing : float
        Of these.
    """
    scale, margin = measure_scale(cloud_pass, spacing), MARGIN * spacing
    outliers = strays = 0
    for _ in range(ROUNDS):
        far = 0
        if (cells := _find_outliers(cloud_pass, spacing)) is not None:
            cloud_pass, counts = cloud_pass.rewrite(tasks.drop_cells, cells)
            far = sum(count for (count,) in counts)
        given = cloud_pass.cloud.low, scale
        cloud_pass, counts = cloud_pass.rewrite(tasks.drop_strays, *given, margin=margin)
        near = sum(count for (count,) in counts)
        outliers, strays = outliers + far, strays + near
        if near <= _MANY * len(cloud_pass.cloud):
            break
    if outliers + strays:
        spacing = measure_spacing(cloud_pass)
    return cloud_pass, Cleaned(outliers, strays), spacing


def mend_normals(cloud_pass: PassT, spacing: float) -> tuple[PassT, int]:
    """Turn round the normals that their neighbours contradict, and return how many they were.

    Parameters
    ----------
    cloud_pass : CloudPass
        Through points with unit normals.
    spacing : float
        Of its points, in length units of the input.
    """
    margin = consistency.MARGIN * spacing
    corner = lay_lattice(cloud_pass.cloud.low, spacing)
    cloud_pass, counts = cloud_pass.rewrite(tasks.mend_region, corner, spacing, margin=margin)
    return cloud_pass, sum(count for (count,) in counts)


def _find_outliers(cloud_pass: CloudPass, spacing: float) -> DroppedCells | None:
    """Return the cells whose points lie apart from every surface; None where there are none."""
    low = lay_lattice(cloud_pass.cloud.low, spacing)
    margin = outlier_regions.MARGIN * spacing
    ranks = cloud_pass.each(tasks.rank_region, low, spacing, margin=margin)
    judged = outlier_regions.judge_sparse(ranks)
    strays = [judged.stray_cells]
    if any(by_rank[judged.base + 1 : -1].any() for by_rank, *_ in ranks):
        strays += cloud_pass.each(tasks.judge_region, low, spacing, judged.base, margin=margin)
    cells = unique_keys(np.concatenate(strays))
    if not (len(cells) or len(judged.island_cells)):
        return None
    return DroppedCells(low, spacing, cells, judged.island_cells)
