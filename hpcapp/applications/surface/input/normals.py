"""Normals for points that have none: estimated, and turned to one side over the whole object."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hpccomponent.surface.cloud.spacing import estimate_spacing
from hpccomponent.surface.kernels import bound_points
from hpccomponent.surface.normals.estimation import estimate_normals
from hpccomponent.surface.normals.orientation import SURE, orient_patches
from hpccomponent.surface.normals.patches import group_points, link_patches
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = ["FROM_FILE", "Oriented", "orient_cloud"]

log = logging.getLogger("hpcapp")

_DOUBTFUL = 0.9  # share of points whose side is sure, below which somebody should look


@dataclass(frozen=True, slots=True)
class Oriented:
    """How the normals of a cloud came about.

    Parameters
    ----------
    source : str
        ``file`` or ``estimated``.
    sure : float
        Share of the points whose side is sure, 0 to 1.
    """

    source: str
    sure: float

    @property
    def warnings(self) -> list[str]:
        """What should make the user doubt them."""
        if self.sure >= _DOUBTFUL:
            return []
        return [
            f"the side of {100.0 * (1.0 - self.sure):.1f} % of the normals is unsure: give "
            "--viewpoint, or normals"
        ]

    def report(self, path: Path) -> None:
        """Log how they came about.

        Parameters
        ----------
        path : Path
            Of the file, for the messages.
        """
        if self.source != "file":
            sure = 100.0 * self.sure
            log.info("%s: normals: estimated; %.1f %% of the points surely oriented", path, sure)
        for warning in self.warnings:
            log.warning("warning: %s: %s", path, warning)

    def to_json(self) -> dict[str, Any]:
        """Return the same for the job's report."""
        return {"source": self.source, "sure": round(self.sure, 4)}


FROM_FILE = Oriented("file", 1.0)
"""They are those of the file."""


def orient_cloud(cloud: PointCloud, scanners: FloatArray | None) -> tuple[PointCloud, Oriented]:
    """Estimate normals and turn them to one side.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions; arranged, or not.
    scanners : ndarray of float64, shape (s, 3), or None
        Where scanners stood, in the frame of the positions.

    Returns
    -------
    cloud : PointCloud
        With unit normals, and the attribute ``confidence``: 0 to 1, how sure their side is.
    oriented : Oriented

    Raises
    ------
    InputError
        All points are the same.
    """
    positions = cloud.positions
    spacing, (low, _) = estimate_spacing(positions), bound_points(positions)
    every = np.ones(len(cloud), np.bool_)
    vectors = estimate_normals(positions, every, low, spacing)
    grouped = group_points(positions, vectors, low, spacing)
    links = link_patches(positions, every, grouped.patch_of, spacing)
    found = orient_patches(grouped.patches, links, spacing, scanners)
    signs = np.where(grouped.is_opposed, -1.0, 1.0) * found.signs[grouped.patch_of]
    wide = vectors.astype(np.float64)
    lengths = np.sqrt(np.einsum("ij,ij->i", wide, wide))
    normals = (wide * (signs / lengths)[:, None]).astype(np.float32).astype(np.float64)
    confidences = found.confidences[grouped.patch_of]
    sure = float(np.count_nonzero(confidences >= SURE)) / len(cloud)
    attributes = {**cloud.attributes, "confidence": confidences.astype(np.float32)}
    return replace(cloud, normals=normals, attributes=attributes), Oriented("estimated", sure)
