"""How far a mesh's vertices are from the points that support them.

::

    vertex ── offset to each point near it ──> along the surface there, and off it
                                               └──> clearance: 1 where support ends
                   and to a step aside in some ways ──> the largest: 1 at the border

A point supports the surface in a flat ellipsoid around it: as far as its radius, some spacings of
the points there, along the plane that its normal stands on, and half of that off that plane, or of
the radius by the whole cloud's spacing where that is less. So a sheet that bends back
behind the rim of the points, or runs behind them, is not theirs. Three points must agree: a lone
one has no surface, and the line where support ends does not follow single points.

What the points support is drawn back by half of that at its border (a morphological closing of the
points): gaps as wide as a diameter stay filled, and nothing is invented around the scan. A place
belongs to the surface where all places half a radius beside it are supported, too, or where
three points are very near. What is found depends on the place and the cloud alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray, PointCloud
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


_FLATNESS = 0.5  # of the ellipsoids, where points are as dense as those of the whole cloud
"""As much of a radius is drawn back at the border: of .33, .5 and .67, invented beyond a sounder's
swath are 8, 5 and 4 %, and of a yard of far rings 4.1, 4.1 and 4.7 % are missing."""

_NEIGHBOURS = 6  # which one's distance tells a point's own spacing
_DENSITY = np.sqrt(np.pi / _NEIGHBOURS)  # times that distance
_AGREEING = 3  # points, of which the one that supports least counts
_WAYS = 8  # along the surface, in which it is looked whether support goes on
_LEAST, _MOST = 0.85, 1.0 + _FLATNESS  # clearances are clamped to these; 1 is asked for
_PLACES_AT_ONCE = 1 << 17  # with eight ways of 24 bytes each; no result depends on it


@record("surface.support_rule")
@dataclass(frozen=True, slots=True, eq=False)
class SupportRule:
    """How far the points support the surface.

    The radius of a point is `least`, in length units of the input, or so many spacings of the
    points there, where that is more.
    """

    least: float
    spacings: float
    scale: LocalScale

    @property
    def typical(self) -> float:
        """The radius by the spacing of the whole cloud."""
        return max(self.least, self.spacings * self.scale.spacing)

    @property
    def reach(self) -> float:
        """How far from a place points may lie that its clearance depends on."""
        return _MOST * self.most + self._farthest

    @property
    def most(self) -> float:
        """The largest radius."""
        return max(self.typical, self.spacings * self.scale.range[1])

    @property
    def _farthest(self) -> float:
        """Neighbours that are farther away do not make a radius larger."""
        return self.most / (self.spacings * _DENSITY) if self.spacings else 0.0

    def radii(self, places: FloatArray) -> FloatArray:
        """Return the radius of points at some places, in length units of the input."""
        return np.maximum(self.least, self.spacings * self.scale.at(places))

    def own_radii(
        self, tree: cKDTree, rows: IntArray, radii: FloatArray, threads: int
    ) -> FloatArray:
        """Return the radii (k,) of some rows of the tree, which has all points around.

        They lie between those by the spacing around, `radii` (k,), and by that of the whole cloud:
        few points in a corner that is hardly seen make no sparse surface.
        """
        if not self.spacings:
            return radii
        distances, _ = tree.query(
            tree.data[rows],
            [_NEIGHBOURS + 1],
            distance_upper_bound=self._farthest * (1.0 + 1e-9),
            workers=threads,
        )
        bounds = np.minimum(radii, self.typical), np.maximum(radii, self.typical)
        # (k, 1): a disc up to the sixth neighbour has six points, which tell the spacing; infinite
        # where that one is too far off, until it is clipped.
        own: FloatArray = (self.spacings * _DENSITY * distances[:, 0]).clip(*bounds)
        return own

    def thickness(self, radii: FloatArray) -> FloatArray:
        """Return how far off their plane points of some radii support."""
        return _FLATNESS * np.minimum(radii, self.typical)


def measure_clearance(
    places: FloatArray, cloud: PointCloud, rule: SupportRule, threads: int = 1
) -> Float32Array:
    """Tell how far places (v, 3) on a surface are from the points that support them, (v,).

    It is in radii of the points: below 1 where points support the surface, clamped to 0.85 and 1.5.
    The cloud has normals, and all points within `rule.reach` of a place, in any order.
    """
    if not len(places) or not len(cloud):
        return np.full(len(places), _MOST, np.float32)
    from scipy.spatial import cKDTree  # heavy, and of no use where nothing is cut

    tree = cKDTree(cloud.positions, balanced_tree=False, compact_nodes=False)
    bound, radii = _MOST * rule.most, rule.radii(cloud.positions)
    # (v,): most places are so near to three points, or so far from them, that no more is asked.
    distances, _ = tree.query(places, [_AGREEING], distance_upper_bound=bound, workers=threads)
    is_supported = distances[:, 0] <= _LEAST * rule.thickness(rule.radii(places))
    is_near = distances[:, 0] < bound
    clearance = np.where(is_near, _LEAST, _MOST)
    unsure = np.flatnonzero(is_near & ~is_supported)
    if not len(unsure):
        return clearance.astype(np.float32)
    # (n,): how far each point is from the nearest of these places.
    from_places, _ = cKDTree(places[unsure]).query(
        cloud.positions, distance_upper_bound=bound, workers=threads
    )
    # (k,): points that may matter to one, and their radii
    rows = np.flatnonzero(from_places < _MOST * np.maximum(radii, rule.typical))
    radii = rule.own_radii(tree, rows, radii[rows], threads)
    points = _lay_ellipsoids(cloud.take(rows), radii, rule)
    for start in range(0, len(unsure), _PLACES_AT_ONCE):
        some = unsure[start : start + _PLACES_AT_ONCE]
        supporting, normals = kernels.count_supporting(places[some], *points, threads)
        # (w,): where there is support; (w, k, 3): ways aside, of which the farthest counts
        inner = np.flatnonzero(supporting >= _AGREEING)
        ways = _look_around(normals[inner])
        bounds = _LEAST * _LEAST, _MOST * _MOST
        squares = kernels.measure_aside(
            places[some[inner]], ways, *points, _AGREEING, *bounds, threads
        )
        clearance[some] = _MOST
        clearance[some[inner]] = np.sqrt(squares)
    return clearance.clip(_LEAST, _MOST).astype(np.float32)


def find_bare(
    places: FloatArray, clouds: Iterable[PointCloud], rule: SupportRule, threads: int = 1
) -> BoolArray:
    """Tell which of a few places on a surface no points support; the points come in pieces."""
    supporting = np.zeros(len(places), np.int64)
    for cloud in clouds:
        points = _lay_ellipsoids(cloud, rule.radii(cloud.positions), rule)
        supporting += kernels.count_supporting(places, *points, threads)[0]
    bare: BoolArray = supporting < _AGREEING
    return bare


def _lay_ellipsoids(
    cloud: PointCloud, radii: FloatArray, rule: SupportRule
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return points as `kernels.count_supporting` takes them."""
    assert cloud.normals is not None  # noqa: S101 - the points of a surface have normals
    return cloud.positions, cloud.normals, radii, rule.thickness(radii)


def _look_around(normals: FloatArray) -> FloatArray:
    """Return ways in the plane that each normal stands on, shape (w, k, 3), of unit length."""
    # (w, 3): the axis that is farthest from each normal, so that no product is near 0.
    axes = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    one = np.cross(normals, axes)
    other = np.cross(normals, one)
    one, other = (some / np.sqrt(_square(some)).clip(1e-300)[:, None] for some in (one, other))
    turns = 2.0 * np.pi * np.arange(_WAYS) / _WAYS
    ways: FloatArray = (
        np.cos(turns)[:, None] * one[:, None] + np.sin(turns)[:, None] * other[:, None]
    )
    return ways


def _square(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T
    squares: FloatArray = x * x + y * y + z * z
    return squares
