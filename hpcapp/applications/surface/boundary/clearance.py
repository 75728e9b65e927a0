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

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.lattice import (
    NEIGHBOURS,
    find_keys,
    number_keys,
    pack_places,
    step_keys,
)
from hpcapp.geometry.points import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    PointCloud,
)
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
_CLASS = 1.25  # points whose radii differ by less are searched together
_PLACES_AT_ONCE, _PLACES_HELD = 1 << 10, 1 << 18
_FINE = float(1 << 20)  # so many whole steps make 1: sums of them are exact


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
        In radii of the points: below 1 where points support the surface. Clamped to 0.85 and 1.5.
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
    matter = cloud.take(rows)
    for start in range(0, len(unsure), _PLACES_HELD):
        some = unsure[start : start + _PLACES_HELD]
        clearance[some] = _measure_unsure(places[some], matter, radii, rule)
    return clearance.clip(_LEAST, _MOST).astype(np.float32)


def _measure_unsure(
    places: FloatArray, cloud: PointCloud, radii: FloatArray, rule: SupportRule
) -> FloatArray:
    """Return the clearances of places, each with all points that matter to one of them."""
    clearance = np.full(len(places), _MOST)
    # (u,), (u, 3): how many points support each place, and the sum of their normals.
    supporting, normals = np.zeros(len(places), np.int64), np.zeros((len(places), 3))
    for run, pairs in _pair_places(places, cloud, radii, rule, 1.0):
        supporting[run] += pairs.count()
        normals[run] += pairs.add_normals()
    # (w,): where there is support; (w, k): by how many points a step aside in k ways
    inner = np.flatnonzero(supporting >= _AGREEING)
    ways = _look_around(normals[inner])
    around = np.zeros(ways.shape[:2], np.int64)
    for run, pairs in _pair_places(places[inner], cloud, radii, rule, _MOST):
        around[run] += pairs.count_aside(ways[run])
    clearance[inner] = _LEAST
    # (m, k, 3): the least squared clearances there, of which the third counts, at the border
    border = np.flatnonzero((around < _AGREEING).any(axis=1))
    inner, ways = inner[border], ways[border]
    least = np.full((*ways.shape[:2], _AGREEING), _MOST * _MOST)
    for run, pairs in _pair_places(places[inner], cloud, radii, rule, _MOST):
        _lower(least[run], pairs.at, pairs.step_aside(ways[run]))
    clearance[inner] = np.sqrt(least.max(axis=(1, 2)))
    return clearance


def find_bare(places: FloatArray, cloud: PointCloud, rule: SupportRule) -> BoolArray:
    """Tell which of a few places on a surface no points support."""
    supporting = np.zeros(len(places), np.int64)
    if len(places) and len(cloud):
        for run, pairs in _pair_places(places, cloud, rule.radii(cloud.positions), rule, 1.0):
            supporting[run] += pairs.count()
    bare: BoolArray = supporting < _AGREEING
    return bare


def _by_radius(radii: FloatArray) -> list[IntArray]:
    """Return the rows of points whose radii are about the same."""
    if not len(radii):
        return []
    classes = np.floor(np.log(radii / radii.min()) / np.log(_CLASS) + 1e-6).astype(np.int64)
    return [np.flatnonzero(classes == one) for one in np.unique(classes)]


def _lower(least: FloatArray, at: IntArray, squares: FloatArray) -> None:
    """Put some squared clearances, shape (q, k), among the least ones of the places they are of."""
    order = np.argsort(at, kind="stable")
    at = at[order]
    # (q,): the how-manieth of its place each one is.
    turn = np.arange(len(at)) - np.searchsorted(at, at)
    # (p, k, w): those of each place side by side
    here = np.full((*least.shape[:2], int(turn.max(initial=-1)) + 1), _MOST * _MOST)
    here[at, :, turn] = squares[order]
    # (p, k, 3 + w): old and new ones, of which the three least stay, in any order.
    both = np.concatenate([least, here], axis=2)
    least[:] = np.partition(both, _AGREEING - 1, axis=2)[:, :, :_AGREEING]


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


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Places, each with a point near it.

    Parameters
    ----------
    places : int
        So many; p below.
    at : ndarray of int64, shape (q,)
        The place.
    along : ndarray of float64, shape (q, 3)
        From the point to it along the point's plane, in radii.
    squares : ndarray of float64, shape (q,)
        Squared clearances.
    normals : ndarray of float64, shape (q, 3)
        Of the points.
    steps : ndarray of float64, shape (q,)
        How far the border is drawn back, in radii.
    """

    places: int
    at: IntArray
    along: FloatArray
    squares: FloatArray
    normals: FloatArray
    steps: FloatArray

    def count(self) -> IntArray:
        """Return how many points are near each place."""
        return np.bincount(self.at, minlength=self.places)

    def add_normals(self) -> FloatArray:
        """Return the sum of their normals."""
        whole = np.round(self.normals * _FINE)  # their sum is the same in any order
        sums = [np.bincount(self.at, axis, minlength=self.places) for axis in whole.T]
        return np.stack(sums, axis=1)

    def step_aside(self, ways: FloatArray) -> FloatArray:
        """Return the squared clearances, shape (q, k), a step off each place in k ways."""
        # (q, k): along . way. A step s leaves what is off the plane as it is, and makes the square
        # of what is along it larger by 2 s along . way + s^2.
        aside = np.zeros((len(self.at), ways.shape[1]))
        for axis in range(3):
            aside += ways[self.at, :, axis] * self.along[:, axis, None]
        steps = self.steps[:, None]
        squares: FloatArray = self.squares[:, None] + 2.0 * steps * aside + steps * steps
        return squares

    def count_aside(self, ways: FloatArray) -> IntArray:
        """Return how many points are very near there, shape (p, k)."""
        point, way = np.nonzero(self.step_aside(ways) <= _LEAST * _LEAST)
        number = ways.shape[1]
        counts = np.bincount(self.at[point] * number + way, minlength=self.places * number)
        return counts.reshape(self.places, number)


def _pair_places(
    places: FloatArray, cloud: PointCloud, radii: FloatArray, rule: SupportRule, most: float
) -> Iterator[tuple[slice, _Pairs]]:
    """Pair some places at a time with the points within a clearance, of like radii at a time."""
    for alike in _by_radius(radii):
        yield from _pair_alike(places, cloud.take(alike), radii[alike], rule, most)


def _pair_alike(
    places: FloatArray, cloud: PointCloud, radii: FloatArray, rule: SupportRule, most: float
) -> Iterator[tuple[slice, _Pairs]]:
    """Pair some places at a time with the points within a clearance."""
    assert cloud.normals is not None  # noqa: S101 - the points of a surface have normals
    if not len(places):
        return
    # Cells as large as the reach: what is near a place is in its cell or in the 26 around it.
    size, origin = most * float(radii.max()), cloud.positions[0]
    thickness = rule.thickness(radii)
    sorted_points = kernels.sort_points(cloud.positions, origin, size)
    for start in range(0, len(places), _PLACES_AT_ONCE):
        batch = places[start : start + _PLACES_AT_ONCE]
        cells = np.floor((batch - origin) / size).astype(np.int64)
        at, point = _pair(cells, *sorted_points)
        offsets, normals = batch[at] - cloud.positions[point], cloud.normals[point]
        off = np.zeros(len(at))  # (q,): how far each is off the point's plane
        for axis in range(3):  # sums in one order, whatever the shape
            off += offsets[:, axis] * normals[:, axis]
        # (q, 3), (q,): what is left along the plane, in radii; then both parts by the axes of the
        # point's ellipsoid, on which the sum of their squares is 1.
        along = (offsets - off[:, None] * normals) / radii[point, None]
        squares = _square(along) + (off / thickness[point]) ** 2
        near = np.flatnonzero(squares < most * most)
        steps = (thickness / radii)[point[near]]
        yield (
            slice(start, start + len(batch)),
            _Pairs(len(batch), at[near], along[near], squares[near], normals[near], steps),
        )


def _pair(
    cells: IntArray, keys: IntArray, offsets: IntArray, rows: NDArray[np.uint32]
) -> tuple[IntArray, IntArray]:
    """Return each place with the points in its cell and the 26 around it."""
    names, name = number_keys(pack_places(cells))  # places are many, their cells few
    around = np.stack([find_keys(keys, step_keys(names, step)) for step in NEIGHBOURS], axis=1)
    ends = np.append(offsets, offsets[-1])  # no cell is the last one
    # (27 p,): the points of each place in each of the cells
    first = ends[around][name].ravel()
    counts = (ends[around + 1] - ends[around])[name].ravel()
    # (q,): in its cell, the how-manieth point each one is.
    turn = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    at = np.repeat(np.arange(len(counts)) // len(NEIGHBOURS), counts)
    return at, rows[np.repeat(first, counts) + turn].astype(np.int64)
