"""What is known of the sides of normals: whether they contradict each other, how they came about.

Every job asks; what estimates normals (`normals`) is only imported where it is needed.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpcapp.applications.surface.scans import Passes
from hpccomponent.surface.cloud.disk import DiskCloud
from hpccomponent.surface.cloud.spacing import estimate_spacing
from hpccomponent.surface.kernels import bound_points, sample_boxes
from hpccomponent.surface.normals import patches
from hpccomponent.surface.normals.consistency import share_opposed
from hpccomponent.surface.tasks.blocks import sample_blocks
from hpccomponent.surface.types.points import PointCloud

__all__ = ["FROM_FILE", "Oriented", "is_contradicting", "is_contradicting_there"]

log = logging.getLogger("hpcapp")

_SAMPLE = 20_000  # points that show whether normals contradict each other
_CONTRADICTING = 0.12  # share of opposite pairs: 6 in 100 turned round
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
    turned : int
        How many normals of the file were turned round, patch by patch.
    """

    source: str
    sure: float
    turned: int = 0

    @property
    def warnings(self) -> list[str]:
        """What should make the user doubt them."""
        found = []
        if self.turned:
            found.append(
                f"the normals contradict each other: {self.turned} were turned round, so that all "
                "are on one side; --normals file takes them as they are"
            )
        if self.sure < _DOUBTFUL:
            found.append(
                f"the side of {100.0 * (1.0 - self.sure):.1f} % of the normals is unsure: say "
                "where the scanner stood (--viewpoint)"
            )
        return found

    def report(self, shown: str) -> None:
        """Log how they came about.

        Parameters
        ----------
        shown : str
            The input, for the messages.
        """
        if self.source != "file":
            sure = 100.0 * self.sure
            log.info("%s: normals: estimated; %.1f %% of the points surely oriented", shown, sure)
        for warning in self.warnings:
            log.warning("warning: %s: %s", shown, warning)

    def to_json(self) -> dict[str, Any]:
        """Return the same for the job's report."""
        return {"source": self.source, "sure": round(self.sure, 4), "turned": self.turned}


FROM_FILE = Oriented("file", 1.0)
"""They are those of the file."""


def is_contradicting(cloud: PointCloud) -> bool:
    """Tell whether the normals of points in memory contradict each other.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions, and unit normals.

    Returns
    -------
    bool
        Whether more than a twentieth of them, or so, is turned round.
    """
    assert cloud.normals is not None  # noqa: S101 - or there is nothing to ask
    spacing, (low, _) = estimate_spacing(cloud.positions), bound_points(cloud.positions)
    edge = patches.CELL * spacing
    rows = sample_boxes(cloud.positions, low, edge, _sample_step(len(cloud)))
    some = cloud.positions[rows], cloud.normals[rows]
    return share_opposed(*some, low, edge, spacing) > _CONTRADICTING


def is_contradicting_there(cloud: DiskCloud, passes: Passes, spacing: float) -> bool:
    """Tell of a cloud in a folder what `is_contradicting` tells of one in memory.

    Parameters
    ----------
    cloud : DiskCloud
    passes : Passes
    spacing : float
        Of the cloud, in length units of the input.

    Returns
    -------
    bool
    """
    edge = patches.CELL * spacing
    step = _sample_step(len(cloud))
    found = passes.map_blocks(sample_blocks, cloud, None, cloud.low, edge, step)
    positions, normals = (np.concatenate(column) for column in zip(*found, strict=True))
    return share_opposed(positions, normals, cloud.low, edge, spacing) > _CONTRADICTING


def _sample_step(points: int) -> int:
    return points // _SAMPLE + 1
