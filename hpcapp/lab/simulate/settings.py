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
    """How a shape is scanned: the options of ``hpcapp simulate --shape``, which say what each is.

    Points are exactly as many, outliers included. Views are spread evenly on a sphere; without any
    the whole surface is sampled, seen or not, with its noise along the normal. Noise is independent
    from point to point, along the ray. Drift is smooth along the surface, each view has its own,
    and errors at a distance r are correlated by exp(-r^2 / (2 correlation^2)). Dropout is below 1.
    A pose error is that along each axis; the rotation moves the shape's ends by as much again. Half
    of the outliers are strewn near the surface along their rays (2 to 10 % of the diagonal), half
    anywhere in twice the bounding box. Density falls along an oblique direction. Missing balls have
    a radius of 5 % of the diagonal. Normals are those of planes through 20 neighbours, turned
    towards the scanner, or the shape's own.
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
