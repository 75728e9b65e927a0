"""``--method paper``: the paper's algorithm in full, as a strategy object.

::

    partition ─── kd-tree, by the normal cone and max_points, or by count     kdtree.py
    fit ───────── one quadric for each patch, in equal batches, on workers    patch_quadrics.py
    extract ───── indicator blend on a grid of nodes, marching cubes          indicator_blend.py

The preprocessing (outliers, noise, density) is the pipeline's, by the steps of `preprocess.py`.

What it can reproduce of the paper's figures, and what not: ``docs/explanation/paper.md``.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.methods.method import Advance, ShowPart, show_nothing
from hpcapp.applications.surface.paper.indicator_blend import (
    extract_iso_surface,
    plan_grid,
    sample_indicator_blend,
    settle_zeros,
)
from hpcapp.applications.surface.paper.kdtree import (
    SplitRule,
    TreePatches,
    partition_by_count,
    partition_by_rule,
)
from hpcapp.applications.surface.paper.patch_quadrics import (
    evaluate_quadrics,
    fit_patches,
    gradient_quadrics,
)
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.workforce import Workforce, map_batches
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

#: Residuals are measured on no more points than these: three digits need no more.
MOST_MEASURED = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class PaperPartition:
    """The points patch after patch, so that a batch is a slice, and their boxes.

    `fitted`, (p, 10), are the quadrics, once the fit has found them: the job's report measures
    their residuals, so that the time of the fit is that of the fit alone.
    """

    points: PointCloud
    patches: TreePatches
    fitted: list[FloatArray] = field(default_factory=list)


@dataclass(slots=True)
class PaperMethod:
    """The paper's algorithm, with the options of `settings.Paper`.

    Beside these, `cone` may be "none" (see `SplitRule`); for the `root` see `partition_by_rule`.
    """

    delta: float = 0.1
    max_points: int | None = None
    cone: str = "paper"
    root: str = "cube"
    patches: int | None = None
    norm: str = "consistent"
    grid: int = 64
    show_part: ShowPart = show_nothing

    def partition(self, cloud: ArrangedCloud, workforce: Workforce) -> PaperPartition:  # noqa: ARG002 - the protocol's; the tree grows on the master
        """Cut a cloud with unit normals into patches, in this process."""
        points = cloud.take_columns(cloud.keys)
        if points.normals is None:
            raise InputError("the cloud has no normals", "give an oriented cloud")
        if self.patches is not None:
            patches = partition_by_count(points.positions, self.patches, self.root)
        else:
            rule = SplitRule(self.delta, self.cone, self.max_points)
            patches = partition_by_rule(points.positions, points.normals, rule, self.root)
        return PaperPartition(points.take(patches.order), patches)

    def fit(self, partition: PaperPartition, workforce: Workforce, advance: Advance) -> FloatArray:
        """Fit the patches on the workers, as many to each batch: coefficients (p, 10).

        They are in patch coordinates; the partition's `fitted` is set here.
        """
        batches = [self._batch(partition, rows) for rows in workforce.cut(len(partition.patches))]
        quadrics = np.concatenate(map_batches(workforce, fit_patches, batches, advance))
        partition.fitted[:] = [quadrics]
        return quadrics

    def extract(
        self,
        partition: PaperPartition,
        quadrics: FloatArray,
        workforce: Workforce,
        advance: Advance,
    ) -> Surface:
        """Sample the indicator blend on the grid, and extract its 0-level: here, as the paper."""
        del workforce
        nodes = plan_grid(partition.patches, self.grid)
        values = sample_indicator_blend(partition.patches, quadrics, nodes, advance)
        settle_zeros(values)
        mesh = extract_iso_surface(values, nodes, partition.points.origin)
        self.show_part(lambda: mesh)
        return Surface.of_mesh(mesh)

    def close(
        self,
        partition: PaperPartition,
        surface: Surface,
        workforce: Workforce,
        advance: Advance,
    ) -> Surface:
        """Return the surface as it is: the paper does not speak of borders."""
        del partition, workforce, advance
        return surface

    def facts(self, partition: PaperPartition) -> dict[str, object]:
        """Return the number of patches, the rule that made them, and after `fit` its residuals."""
        rule: dict[str, object] = {"root": self.root, "norm": self.norm}
        if self.patches is None:
            rule |= {"delta": self.delta, "cone": self.cone, "max_points": self.max_points}
        return {
            "patches": len(partition.patches),
            "points_fitted": len(partition.points),
            "largest_patch": int(np.diff(partition.patches.offsets).max()),
            **rule,
            **(measure_residuals(partition, partition.fitted[0]) if partition.fitted else {}),
        }

    def _batch(self, partition: PaperPartition, rows: slice) -> tuple[object, ...]:
        offsets = partition.patches.offsets[rows.start : rows.stop + 1]
        points = slice(offsets[0], offsets[-1])
        return (
            partition.points.positions[points],
            _normals(partition)[points],
            offsets - offsets[0],
            partition.patches.centers[rows],
            partition.patches.scales[rows],
            self.norm,
        )


def measure_residuals(partition: PaperPartition, quadrics: FloatArray) -> dict[str, float]:
    """Return how well the quadrics (p, 10) hold their own points (every k-th of a large cloud).

    ``residual_rms``: root mean square of the algebraic values, dimensionless.
    ``residual_median_percent``: median first-order distance |f| / |grad f|, in per cent of the
    diagonal of the points' bounding box. ``normals_agreeing``: the share of the points whose
    normal looks along the gradient.
    """
    patches = partition.patches
    every = slice(None, None, -(-len(partition.points) // MOST_MEASURED))
    positions, normals = partition.points.positions[every], _normals(partition)[every]
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))[every]
    scales = patches.scales[owner]
    local = (positions - patches.centers[owner]) / scales[:, None]
    values = evaluate_quadrics(quadrics[owner], local)
    gradients = gradient_quadrics(quadrics[owner], local)
    steepness = np.linalg.norm(gradients, axis=1)
    distances = scales * np.abs(values) / np.maximum(steepness, np.finfo(float).tiny)
    low, high = bound_points(partition.points.positions)
    diagonal = float(np.linalg.norm(high - low)) or 1.0
    agreeing = (gradients * normals).sum(axis=1) > 0.0
    return {
        "residual_rms": float(np.sqrt(np.mean(values**2))),
        "residual_median_percent": 100.0 * float(np.median(distances)) / diagonal,
        "normals_agreeing": float(agreeing.mean()),
    }


def _normals(partition: PaperPartition) -> FloatArray:
    assert partition.points.normals is not None  # noqa: S101 - or there would be no partition
    return partition.points.normals
