"""How far a mesh's vertices are from the points that support them.

::

    vertex ── offset to each point near it ──> along the surface there, and off it
                                               └──> clearance: 1 where support ends

A point supports the surface in a flat ellipsoid around it: as far as its radius, some spacings of
the points there, along the plane that its normal stands on, and half of that off that plane, or of
the radius by the whole cloud's spacing where that is less. So a sheet that bends back
behind the rim of the points, or runs behind them, is not theirs. Three points must agree: a lone
one has no surface, and the line where support ends does not follow single points. What is found
depends on the place and the cloud alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.types.lattice import find_keys, pack_places
from hpcapp.applications.surface.types.points import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    PointCloud,
)
from hpccomponent.protocol.records import record

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

__all__ = ["SupportRule", "find_bare", "measure_clearance"]

_FLATNESS = 0.5  # of the ellipsoids, where points are as dense as those of the whole cloud
_NEIGHBOURS = 6  # which one's distance tells a point's own spacing
_DENSITY = np.sqrt(np.pi / _NEIGHBOURS)  # times that distance
_AGREEING = 3  # points, of which the one that supports least counts
_LEAST, _MOST = 0.85, 1.4  # clearances are clamped to these: only those around 1 are asked for
_CLASS = 1.25  # points whose radii differ by less are searched together
_PLACES_AT_ONCE = 1 << 10


@record("surface.support_rule")
@dataclass(frozen=True, slots=True, eq=False)
class SupportRule:
    """How far the points support the surface.

    Parameters
    ----------
    least : float
        The radius of a point, in length units of the input.
    spacings : float
        The radius in spacings, where that is more.
    scale : LocalScale
        Of the points.
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
        """Return the radii of some points by their own neighbours.

        They lie between those by the spacing around and by that of the whole cloud: few points in
        a corner that is hardly seen make no sparse surface.

        Parameters
        ----------
        tree : cKDTree
            Of all points around.
        rows : ndarray of int64, shape (k,)
            Of these.
        radii : ndarray of float64, shape (k,)
            By the spacing around.
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
        own: FloatArray = (self.spacings * _DENSITY * distances[:, 0]).clip(*bounds)
        return own

    def thickness(self, radii: FloatArray) -> FloatArray:
        """Return how far off their plane points of some radii support."""
        return _FLATNESS * np.minimum(radii, self.typical)


def measure_clearance(
    places: FloatArray, cloud: PointCloud, rule: SupportRule, threads: int = 1
) -> Float32Array:
    """Tell how far some places on a surface are from the points that support them.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 3)
        In length units of the input.
    cloud : PointCloud
        With normals; all points within `rule.reach` of a place, in any order.

    Returns
    -------
    ndarray of float32, shape (v,)
        In radii of the points: below 1 where points support the surface. Clamped to 0.85 and 1.4.
    """
    if not len(places) or not len(cloud):
        return np.full(len(places), _MOST, np.float32)
    from scipy.spatial import cKDTree  # heavy, and of no use where nothing is cut

    tree = cKDTree(cloud.positions, balanced_tree=False, compact_nodes=False)
    bound, radii = _MOST * rule.most, rule.radii(cloud.positions)
    # (v, 3): the nearest points bound a place's clearance on both sides: most places are sure of
    # theirs by that.
    distances, nearest = tree.query(places, _AGREEING, distance_upper_bound=bound, workers=threads)
    inner = np.append(_LEAST * rule.thickness(radii), 0.0)  # no point is nearer than nothing
    is_supported = (distances <= inner[nearest]).all(axis=1)
    is_near = distances[:, -1] < bound
    clearance = np.where(is_near, _LEAST, _MOST)
    unsure = np.flatnonzero(is_near & ~is_supported)
    if not len(unsure):
        return clearance.astype(np.float32)
    from_places, _ = cKDTree(places[unsure]).query(
        cloud.positions, distance_upper_bound=bound, workers=threads
    )
    # (k,): points that may matter to one, and their radii
    rows = np.flatnonzero(from_places < _MOST * np.maximum(radii, rule.typical))
    radii = rule.own_radii(tree, rows, radii[rows], threads)
    # (u, 3): the least squared clearances of each, of which the third counts.
    least = np.full((len(unsure), _AGREEING), _MOST * _MOST)
    for alike in _by_radius(radii):
        points = cloud.take(rows[alike])
        for run, at, squares in _near_places(places[unsure], points, radii[alike], rule):
            _lower(least[run], at, squares)
    clearance[unsure] = np.clip(np.sqrt(least[:, -1]), _LEAST, _MOST)
    return clearance.astype(np.float32)


def find_bare(places: FloatArray, cloud: PointCloud, rule: SupportRule) -> BoolArray:
    """Tell which of a few places on a surface no points support."""
    supporting = np.zeros(len(places), np.int64)
    if len(places) and len(cloud):
        radii = rule.radii(cloud.positions)
        for alike in _by_radius(radii):
            points = cloud.take(alike)
            for run, at, squares in _near_places(places, points, radii[alike], rule):
                supporting[run] += np.bincount(at[squares < 1.0], minlength=run.stop - run.start)
    bare: BoolArray = supporting < _AGREEING
    return bare


def _by_radius(radii: FloatArray) -> list[IntArray]:
    """Return the rows of points whose radii are about the same."""
    if not len(radii):
        return []
    classes = np.floor(np.log(radii / radii.min()) / np.log(_CLASS) + 1e-6).astype(np.int64)
    return [np.flatnonzero(classes == one) for one in np.unique(classes)]


def _lower(least: FloatArray, at: IntArray, squares: FloatArray) -> None:
    """Put some squared clearances among the least ones of the places that they are of."""
    # Sorted by place and clearance: the first three of each go into its row.
    order = np.lexsort((squares, at))
    at, squares = at[order], squares[order]
    turn = np.arange(len(at)) - np.searchsorted(at, at)
    first = turn < _AGREEING
    here = np.full((len(least), _AGREEING), _MOST * _MOST)
    here[at[first], turn[first]] = squares[first]
    both = np.concatenate([least, here], axis=1)
    least[:] = np.sort(both, axis=1)[:, :_AGREEING]


def _near_places(
    places: FloatArray, cloud: PointCloud, radii: FloatArray, rule: SupportRule
) -> Iterator[tuple[slice, IntArray, FloatArray]]:
    """Pair some places at a time with the points near them.

    Yields
    ------
    run : slice
        Of the places.
    at : ndarray of int64, shape (q,)
        The place of each pair, in the run.
    squares : ndarray of float64, shape (q,)
        Squared clearances.
    """
    assert cloud.normals is not None  # noqa: S101 - the points of a surface have normals
    size, origin = _MOST * float(radii.max()), cloud.positions[0]
    along_most, off_most = radii * radii, rule.thickness(radii) ** 2  # where 1 is, squared
    sorted_points = kernels.sort_points(cloud.positions, origin, size)
    for start in range(0, len(places), _PLACES_AT_ONCE):
        batch = places[start : start + _PLACES_AT_ONCE]
        cells = np.floor((batch - origin) / size).astype(np.int64)
        # (q,): each place with each point near it; (q,) how far it is off the point's plane, and
        # how far away, squared.
        at, point = _pair(cells, *sorted_points)
        offsets = batch[at] - cloud.positions[point]
        off, along = np.zeros(len(at)), np.zeros(len(at))
        for axis in range(3):  # sums in one order, whatever the shape
            off += offsets[:, axis] * cloud.normals[point, axis]
            along += offsets[:, axis] * offsets[:, axis]
        off *= off
        squares = (along - off) / along_most[point] + off / off_most[point]
        is_near = squares < _MOST * _MOST
        yield slice(start, start + len(batch)), at[is_near], squares[is_near]


def _pair(
    cells: IntArray, keys: IntArray, offsets: IntArray, rows: NDArray[np.uint32]
) -> tuple[IntArray, IntArray]:
    """Return each place with the points in its cell and the 26 around it."""
    at, points = [], []
    for step in np.ndindex(3, 3, 3):
        cell = find_keys(keys, pack_places(cells + np.array(step) - 1))
        here = np.flatnonzero(cell < len(keys))
        first = offsets[cell[here]]
        counts = offsets[cell[here] + 1] - first
        turn = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
        at.append(np.repeat(here, counts))
        points.append(rows[np.repeat(first, counts) + turn].astype(np.int64))
    return np.concatenate(at), np.concatenate(points)
