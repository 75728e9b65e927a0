"""How a cloud is cleaned: far, repeated and stray points dropped, wrong normals flipped.

::

    drop_far ─ drop_repeated ─ lines thinned ─ outliers, strays, lone lines dropped
                                                   └── (normals) ── normals mended

What lies closer along scan lines than these lie apart is spared (see `scan_lines`). Outliers lie
far from every surface (see `outliers`), strays near one (see `strays`); wires are lone lines (see
`lone_lines`).
"""

from __future__ import annotations

from dataclasses import astuple
from functools import partial

import numpy as np

from hpcapp.applications.surface.cleaning import lone_lines, outlier_regions
from hpcapp.applications.surface.cleaning import tasks as tasks
from hpcapp.applications.surface.cleaning.outlier_regions import DroppedCells
from hpcapp.applications.surface.cleaning.strays import MARGIN, ROUNDS
from hpcapp.applications.surface.cloud.cloud_pass import CloudPass, PassT
from hpcapp.applications.surface.cloud.frame import Frame
from hpcapp.applications.surface.cloud.measure import measure_lines, measure_scale, measure_spacing
from hpcapp.applications.surface.cloud.surface_check import check_surface
from hpcapp.applications.surface.normals import consistency
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.scale.scan_lines import keep_lines
from hpcapp.geometry.lattice import lay_lattice
from hpccomponent.dataclass import dataclass

_MANY = 0.001  # of the points are strays: only then they have vouched for others


@dataclass(frozen=True, slots=True)
class Cleaned:
    """What was found wrong with a cloud, in points.

    Dropped were `outliers`, far from every surface, `strays` near one, those `repeated` at the
    place of another, `spared` along scan lines and on `lone_lines`, as of wires. Normals were
    `flipped`, and steps of depths `smoothed` (see `depth_image.smooth_steps`). `line_gap` and
    `line_step` are from line to line, and from point to point along one, in length units of the
    input: medians over the cells that hold lines; 0 where none does.
    """

    outliers: int = 0
    strays: int = 0
    flipped: int = 0
    repeated: int = 0
    spared: int = 0
    lone_lines: int = 0
    smoothed: int = 0
    line_gap: float = 0.0
    line_step: float = 0.0

    def tell_lines(self) -> dict[str, float] | None:
        """Return the JSON value for scan lines; None where there are none."""
        if not self.spared:
            return None
        return {"gap": self.line_gap, "step": self.line_step, "spared": self.spared}

    def plus(self, other: Cleaned) -> Cleaned:
        """Return what both have found; each thing is found by one of them alone, but outliers."""
        return Cleaned(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


def drop_repeated(cloud_pass: PassT) -> tuple[PassT, int]:
    """Drop the points at the place of one before them, and return how many they were."""
    cloud_pass, counts = cloud_pass.rewrite(tasks.drop_repeated)
    return cloud_pass, sum(count for (count,) in counts)


def clean(
    cloud_pass: PassT, frame: Frame, *, drops: bool, in_cells: bool, has_normals: bool
) -> tuple[PassT, Cleaned, LocalScale]:
    """Drop the points that are not needed, or that belong to no surface, and find the scale.

    There must be ten points or more, without far ones (see `drop_far`). Unless it `drops`, all
    stay. `in_cells` says that the cloud lies in blocks, in whose cells its spacing is told. Returns
    a pass through the points that remain, in their order, and their scale. Raises InputError where
    points without normals lie on no surface. The `frame` tells spacings that are known already.
    """
    cleaned = Cleaned()
    if drops:
        cloud_pass, cleaned, scale = thin_lines(cloud_pass, frame)
    elif in_cells:
        scale = _measure_scale(cloud_pass, frame, "read")
    else:
        scale = LocalScale.uniform(measure_spacing(cloud_pass))
    if not has_normals and (problem := check_surface(cloud_pass, scale.spacing)) is not None:
        raise problem
    if drops:
        cloud_pass, found, scale = drop_strays(cloud_pass, scale, frame)
        cleaned = cleaned.plus(found)
    return cloud_pass, cleaned, scale


def _measure_scale(cloud_pass: CloudPass, frame: Frame, stage: str) -> LocalScale:
    return measure_scale(cloud_pass, frame.space(stage, partial(measure_spacing, cloud_pass)))


def thin_lines(cloud_pass: PassT, frame: Frame | None = None) -> tuple[PassT, Cleaned, LocalScale]:
    """Drop the points along scan lines that are closer than the lines' gap asks for."""
    frame = Frame() if frame is None else frame
    spacing = frame.space("read", partial(measure_spacing, cloud_pass))
    scale, boxes = measure_lines(cloud_pass, spacing)
    if len(boxes.keys):
        boxes = keep_lines(boxes, cloud_pass.each(tasks.count_lines, boxes))
    if not len(boxes.keys):
        return cloud_pass, Cleaned(), scale
    cloud_pass, counts = cloud_pass.rewrite(tasks.thin_lines, boxes)
    scale = _measure_scale(cloud_pass, frame, "thinned")
    gap, step = float(np.median(boxes.gaps)), float(np.median(boxes.steps))
    spared = sum(count for (count,) in counts)
    return cloud_pass, Cleaned(spared=spared, line_gap=gap, line_step=step), scale


def drop_strays(
    cloud_pass: PassT, scale: LocalScale, frame: Frame | None = None
) -> tuple[PassT, Cleaned, LocalScale]:
    """Drop the points that belong to no surface; normals are not asked.

    Where some are gone, fewer are left that could vouch for the others: these are asked again. What
    is given and returned is as of `clean`.
    """
    frame = Frame() if frame is None else frame
    spacing, margin = scale.spacing, MARGIN * scale.spacing
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
    cloud_pass, lone = _drop_lone_lines(cloud_pass, spacing)
    if outliers + strays + lone:
        scale = _measure_scale(cloud_pass, frame, "cleaned")
    return cloud_pass, Cleaned(outliers, strays, lone_lines=lone), scale


def _drop_lone_lines(cloud_pass: PassT, spacing: float) -> tuple[PassT, int]:
    """Drop the points along lone lines, and return how many; where most lie so, all stay."""
    most = lone_lines.MOST * len(cloud_pass.cloud)
    kept, _ = cloud_pass.rewrite(
        tasks.drop_lone_lines,
        cloud_pass.cloud.low,
        spacing,
        margin=lone_lines.MARGIN * spacing,
        accepts=lambda counts: sum(dropped for (dropped,) in counts) <= most,
    )
    return kept, len(cloud_pass.cloud) - len(kept.cloud)


def mend_normals(cloud_pass: PassT, spacing: float) -> tuple[PassT, int]:
    """Turn round unit normals that their neighbours contradict, and return how many they were."""
    margin = consistency.MARGIN * spacing
    given = lay_lattice(cloud_pass.cloud.low, spacing), spacing
    cloud_pass, counts = cloud_pass.rewrite(tasks.mend_region, *given, margin=margin)
    return cloud_pass, sum(count for (count,) in counts)


def _find_outliers(cloud_pass: CloudPass, spacing: float) -> DroppedCells | None:
    """Return the cells whose points lie apart from every surface; None where there are none."""
    low = lay_lattice(cloud_pass.cloud.low, spacing)
    margin = outlier_regions.MARGIN * spacing
    ranks = cloud_pass.each(tasks.rank_region, low, spacing, margin=margin)
    judged = outlier_regions.judge_sparse(ranks)
    if not (len(judged.stray_cells) or len(judged.island_cells)):
        return None
    return DroppedCells(low, spacing, judged.stray_cells, judged.island_cells)
