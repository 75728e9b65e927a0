"""What the lattices of a cloud are laid by: its own box and spacing, or those of an earlier job.

::

    first job   points ──> box, spacings, estimates ──> kept
    update      kept ──> the same lattices: cells without a new point hold what they held

Whatever is measured of all points changes in its last digits with each scan that is added, and
with it every cell, normal and tile.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hpcapp.applications.surface.cloud.arranged import CloudMeasures
from hpcapp.applications.surface.cloud.arrangement import Arrangement, choose_arrangement
from hpcapp.geometry.points import FloatArray, PointCloud

log = logging.getLogger("hpcapp")

_ROOM = 1.0 / 16.0  # of the longest side: new scans reach a little beyond the old ones


class Frame:
    """What the lattices of a job's cloud are laid by.

    By default it is the cloud's own, without room beyond its box. With `keeps` it is for later jobs
    as well, and what is `known` of an earlier one (see `tell`) is taken, as long as the points lie
    in its box: `is_known` says so once they are arranged.
    """

    def __init__(self, known: dict[str, Any] | None = None, *, keeps: bool = False) -> None:
        self._known: dict[str, Any] = known or {}
        self._keeps = keeps
        self.is_known = known is not None
        self._origin = self._known.get("origin")
        self._spacings: dict[str, float] = {}
        self._box: FloatArray | None = None
        self._measured: CloudMeasures | None = None

    def place(self, origin: FloatArray) -> FloatArray:
        """Return the origin (3,) of the local frame, given the one that the points would choose."""
        self._origin = origin if self._origin is None else self._origin
        return self._origin

    def arrange(self, low: FloatArray, high: FloatArray) -> Arrangement:
        """Choose the blocks of a cloud by the box around it; see `choose_arrangement`.

        Those of the earlier job, unless points lie beyond its box: then nothing of it is known.
        """
        if not self._keeps:
            return choose_arrangement(low, high)
        if self.is_known:
            self._box = box = self._known["box"]
            self.is_known = bool((low >= box[0]).all() and (high <= box[1]).all())
            if not self.is_known:
                log.warning(
                    "warning: points lie beyond the box that was laid around those of before: "
                    "all tiles are made again"
                )
        if not self.is_known:
            self._known = {}
            room = _ROOM * float((high - low).max())
            self._box = np.stack([low - room, high + room])
        assert self._box is not None  # noqa: S101 - laid just before
        blocks = choose_arrangement(*self._box)
        return Arrangement(blocks.origin, blocks.edge, self._box)

    def space(self, stage: str, measure: Callable[[], float]) -> float:
        """Return the spacing of the whole cloud at a stage of its cleaning, measured or known.

        A stage that the earlier job did not come to has the spacing of the one before.
        """
        known = self._known.get("spacings")
        if known is None:
            spacing = measure()
        else:
            spacing = known.get(stage) or next(reversed(self._spacings.values()))
        self._spacings[stage] = spacing
        return spacing

    def measure(self, measure: Callable[[], CloudMeasures]) -> CloudMeasures:
        """Return what methods ask of the cloud, measured or known."""
        known = self._known.get("measured")
        self._measured = measure() if known is None else CloudMeasures.of_values(known)
        return self._measured

    def tell(self) -> dict[str, Any]:
        """Return all of it as values that a store takes."""
        assert self._measured is not None  # noqa: S101 - told when all is known
        return {
            "origin": self._origin,
            "box": self._box,
            "spacings": self._spacings,
            "measured": self._measured.to_values(),
        }


def shift_points(points: PointCloud, origin: FloatArray) -> PointCloud:
    """Return points in the local frame of another origin (3,), which are whole numbers mostly."""
    if np.array_equal(points.origin, origin):
        return points
    positions = points.positions + (points.origin - origin)
    return replace(points, positions=positions, origin=origin)
