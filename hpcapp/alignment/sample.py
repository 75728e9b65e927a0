"""A scan as alignment sees it: a sample of its points, thinned to cells of any edge."""

from __future__ import annotations

from dataclasses import field

import numpy as np
from scipy.spatial import KDTree

from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

FEWEST = 32
"""Cells of a scan, below which they show no surface."""
_NEARLY_ALL = (0.005, 0.995)  # quantiles along each axis
_BEYOND = 0.5  # of the box between them, either side: what lies farther out is left out
_NEIGHBOURS = 12  # of which the normal of a cell is made
_DRAWN = 2000  # points that tell the spacing
_RARE = 0.03  # the share below which a direction of normals counts no more than others
_ALIKE = 0.97  # cosine of normals that are counted as one direction, 14 degrees


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """One point and one normal, of unknown side, for each cell of a lattice that has points.

    Weights are less where many cells have the normal: a floor must not outvote all else. Their
    mean is 1.
    """

    edge: float
    positions: FloatArray
    normals: FloatArray
    weights: FloatArray
    tree: KDTree


@dataclass(slots=True, eq=False)
class Sample:
    """Points of a scan about the centre of its box.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        About `centre`.
    centre : ndarray of float64, shape (3,)
        In the coordinates of the scan.
    spacing : float
        Median distance of the third neighbour in what was drawn.
    extent : float
        Diagonal of the box.
    eye : ndarray of float64, shape (3,), or None
        Where the scan was taken from, about `centre`, where that is known or the points tell it.
    """

    positions: FloatArray
    centre: FloatArray
    spacing: float
    extent: float
    eye: FloatArray | None = None
    _cells: dict[float, Cells] = field(default_factory=dict)

    def at(self, edge: float) -> Cells:
        """Return the scan thinned to cells of an edge; made once."""
        if edge not in self._cells:
            self._cells[edge] = thin(self.positions, edge)
        return self._cells[edge]


def sample_scan(positions: FloatArray) -> Sample:
    """Return a sample of points, shape (n, 3) in any frame, n at least 100.

    Points are taken once each, and without those far beyond the box of nearly all: a single one at
    the origin of a map would make a box in which the scan is a speck.
    """
    low, high = np.quantile(positions, _NEARLY_ALL, axis=0)
    wide = (high - low) * _BEYOND
    kept = ((positions >= low - wide) & (positions <= high + wide)).all(axis=1)
    points = np.unique(positions[kept], axis=0)
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    local = points - centre
    drawn = np.random.default_rng(0).permutation(len(local))[:_DRAWN]
    spacing = float(np.median(KDTree(local).query(local[drawn], 4)[0][:, 3]))
    return Sample(local, centre, spacing, float(np.linalg.norm(high - low)))


def thin(positions: FloatArray, edge: float) -> Cells:
    """Return one point for each cell of an edge, with the normal of those around it."""
    keys = np.floor((positions - positions.min(axis=0)) / edge).astype(np.int64)
    sides = tuple(keys.max(axis=0) + 1)
    _, cell, counts = np.unique(
        np.ravel_multi_index(tuple(keys.T), sides), return_inverse=True, return_counts=True
    )
    # (c, 3): the mean of the points of each cell, and (c, k): the cells around it.
    means = np.stack([np.bincount(cell, axis) for axis in positions.T], axis=1) / counts[:, None]
    tree = KDTree(means)
    _, around = tree.query(means, range(1, min(_NEIGHBOURS, len(means)) + 1))
    offsets = means[around] - means[around].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    # (c,): how flat it is there, 1 on a plane, 0 where no direction stands out as the normal.
    flat = 1.0 - np.sqrt(np.maximum(values[:, 0], 0.0) / np.maximum(values[:, 1], 1e-300))
    normals = vectors[:, :, 0]
    weights = flat * _rarity(normals)
    return Cells(edge, means, normals, weights / max(float(weights.mean()), 1e-300), tree)


def _rarity(normals: FloatArray) -> FloatArray:
    """Return a weight for each normal: the fewer have it, the more it tells."""
    drawn = normals[np.random.default_rng(0).permutation(len(normals))[:_DRAWN]]
    both = KDTree(np.concatenate([drawn, -drawn]))  # a normal is the same either way round
    alike = both.query_ball_point(normals, np.sqrt(2 - 2 * _ALIKE), return_length=True)
    return np.asarray(1.0 / (alike / len(drawn) + _RARE))
