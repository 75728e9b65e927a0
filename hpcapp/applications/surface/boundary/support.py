"""How much of a closed surface the points support, and how far the rest is from them."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.boundary.clearance import SupportRule
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.geometry.lattice import unpack_keys
from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

_MEASURED = 256  # places at most: their distances change little from one to the next
_ONE_IN = 16  # blocks that bound distances at first


@dataclass(frozen=True, slots=True)
class Support:
    """How the points support a closed surface: a share of its area, 0 to 1.

    The rest is `farthest` from the nearest point at most, and beyond `reach` no point supports
    anything; both are in length units of the input.
    """

    share: float
    farthest: float
    reach: float


def measure_support(
    share: float, places: FloatArray, cloud: ArrangedCloud, rule: SupportRule
) -> Support:
    """Tell how far the unsupported places (k, 3) of a surface are from the points.

    Points support a `share`. Places are in the cloud's frame; of very many an even sample counts.
    """
    few = places[:: max(1, -(-len(places) // _MEASURED))]
    return Support(share, find_farthest(few, cloud), rule.most)


def find_farthest(places: FloatArray, cloud: ArrangedCloud) -> float:
    """Return the largest distance of places from the point nearest to each; 0 without places.

    A block of points bounds a place's distance from both sides. Places are looked at by their upper
    bounds, until these are below what was found, and points are read of those blocks only that may
    hold the nearest: a few, wherever they are.
    """
    edge = cloud.arrangement.edge
    middles = cloud.arrangement.origin + edge * (unpack_keys(cloud.keys) + 0.5)  # (b, 3)
    radius = 0.5 * edge * np.sqrt(3.0)
    # (k,): from the middles of some blocks, each of which holds a point
    bounds = radius + np.array([_measure(middles[::_ONE_IN], place).min() for place in places])
    farthest = 0.0
    for one in np.argsort(-bounds, kind="stable").tolist():
        if bounds[one] <= farthest:
            break
        away = _measure(middles, places[one])
        least = float(away.min())
        if least + radius > farthest:
            # There is a point within least + radius. A block whose middle is a radius farther away
            # than that holds none that is nearer.
            near = cloud.take_blocks(cloud.keys[away <= least + 2.0 * radius])[0]
            farthest = max(farthest, float(_measure(near, places[one]).min()))
    return farthest


def _measure(positions: FloatArray, place: FloatArray) -> FloatArray:
    """Return the distances of positions from a place."""
    arms = positions - place
    arms *= arms
    lengths: FloatArray = np.sqrt(arms[:, 0] + arms[:, 1] + arms[:, 2])
    return lengths
