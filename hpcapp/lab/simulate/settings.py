"""The settings of a simulated scan, checked as soon as they are given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.ranges import check_range

MOST_POINTS = 10**9
"""Of a scan: it is made in memory, at some hundred bytes a point."""

MOST_VIEWS = 10_000
"""Of a shape: the whole of it is traced for each."""

_MOST_BALLS = 10_000


@dataclass(frozen=True, slots=True)
class ScanSettings:
    """How a shape is scanned.

    Parameters
    ----------
    points : int
        Points of the cloud, outliers included: exactly as many.
    views : int
        Positions of the scanner, spread evenly on a sphere about the shape. 0 samples the whole
        surface evenly instead, seen or not, with its noise along the normal.
    noise : float
        Standard deviation of the depth along the ray, as a fraction of the diagonal; independent
        from point to point.
    drift : float
        Standard deviation of a second error of the depth, as a fraction of the diagonal, which is
        smooth along the surface; each view has its own.
    correlation : float
        Length over which the drift changes, as a fraction of the diagonal: errors at a distance r
        within one view are correlated by exp(-r^2 / (2 correlation^2)).
    dropout : float
        Share of each view's image that is lost, in blotches; from 0 to below 1.
    grazing : float
        Greatest angle between ray and surface normal that still echoes, in degrees.
    pose_error : float
        Standard deviation of each view's shift along each axis, as a fraction of the diagonal;
        its rotation moves the shape's ends by as much again.
    outliers : float
        Share of the points that are wrong: half of them strewn near the surface along their rays
        (2 to 10 % of the diagonal), half anywhere in twice the bounding box.
    density_ratio : float
        Density at the dense end over that at the sparse end, along an oblique direction.
    missing : int
        Balls on the surface, 5 % of the diagonal in radius, from which nothing came back.
    flipped : float
        Share of the points whose normal has the wrong sign.
    normals : {"pca", "exact"}
        From the plane through 20 neighbours, turned towards the scanner; or the shape's own.
    """

    points: int = 100_000
    views: int = 20
    noise: float = 0.0
    drift: float = 0.0
    correlation: float = 0.05
    dropout: float = 0.0
    grazing: float = 80.0
    pose_error: float = 0.0
    outliers: float = 0.0
    density_ratio: float = 1.0
    missing: int = 0
    flipped: float = 0.0
    normals: Literal["pca", "exact"] = "pca"
    seed: int = 0

    def __post_init__(self) -> None:
        ranges: dict[str, tuple[float, float]] = {
            "points": (1, MOST_POINTS),
            "views": (0, MOST_VIEWS),
            "noise": (0.0, 0.2),
            "drift": (0.0, 0.2),
            "correlation": (1e-4, 1.0),
            "dropout": (0.0, 0.95),
            "grazing": (1.0, 90.0),
            "pose_error": (0.0, 0.2),
            "outliers": (0.0, 0.9),
            "density_ratio": (1.0, 1e4),
            "missing": (0, _MOST_BALLS),
            "flipped": (0.0, 1.0),
            "seed": (0, np.inf),
        }
        check_ranges(self, ranges)
        if self.normals not in ("pca", "exact"):
            raise UsageError(f"normals is {self.normals!r}", "choose 'pca' or 'exact'")
        if self.views == 0 and (self.pose_error or self.dropout):
            raise UsageError(
                "pose errors and dropout need a scanner", "ask for at least one view, or for none"
            )


def check_ranges(settings: object, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Raise `UsageError` for the first setting that is not within its range, ends included."""
    for name, (low, high) in ranges.items():
        check_range(name, getattr(settings, name), low, high)
