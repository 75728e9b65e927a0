"""Where a sensor stood, told by how its points lie.

A scanner that turns takes as many points in every direction. So their density falls with the square
of the distance, and nothing but a scan from among things looks even from among them.
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.normals.evidence.seen_sides import areas_of
from hpcapp.applications.surface.normals.patches import CELL, Patches
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass

_SAMPLE = 3000  # patches, about
_NEAREST = 8  # patches whose points make the density of one
_FARTHEST = 64.0  # cells: patches beyond are none of them
_LOW, _HIGH = 0.15, 0.85  # quantiles that a spread lies between
_ROUNDS = 30  # of the fit
_GRAZING = 0.1  # cosine: flatter slopes are known too roughly
_EVEN = 0.5  # spread of the density of objects that were scanned from all around: .35 to .6
_ASIDE, _LEAST_SURFACE = 3.0 * np.pi / 8.0, 0.25  # 0.25: in a corner of a sheet
_LEAST_SPREAD = 0.05  # of densities that were counted


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """How densely points lie around some patches: those in `rows`, (s,), of all.

    `logs`, (s,), are logarithms of the points per area, up to a constant.
    """

    rows: IntArray
    logs: FloatArray

    @classmethod
    def of(cls, patches: Patches, spacing: float) -> Density:
        """Measure it."""
        counts = patches.counts.astype(np.float64)
        rows, edge = np.arange(0, len(patches), -(-len(patches) // _SAMPLE)), CELL * spacing
        corner = lay_lattice(patches.centres.min(axis=0), edge)
        boxes = kernels.sort_points(patches.centres, corner, edge)
        # (s, 8): of each of them the nearest ones, and the squares of their distances.
        nearest = max(min(_NEAREST, len(patches) - 1), 1)
        squares, near = kernels.find_nearest(
            patches.centres, *boxes, edge, rows, nearest, _FARTHEST * edge
        )
        # (s,): what lies within a distance by the square of that.
        held = counts[rows] + np.append(counts, 0.0)[near].sum(axis=1)
        squares = np.clip(squares[:, -1], 1e-300, (_FARTHEST * edge) ** 2)
        # (s,): how much of each disc has surface: at a straight border, half of it, and the mean
        # of that lies 4 / (3 pi) of the radius aside.
        found = np.minimum(near, len(patches) - 1)
        arms = patches.centres[found] - patches.centres[rows, None]
        mean = np.einsum("sk,ski->si", np.append(counts, 0.0)[near], arms) / held[:, None]
        aside = np.sqrt(np.einsum("si,si->s", mean, mean) / squares)
        surface = np.maximum(1.0 - _ASIDE * aside, _LEAST_SURFACE)
        return cls(rows, np.log(held / (surface * squares)))

    def favour(self, patches: Patches, places: FloatArray) -> float:
        """Return how much more evenly points lie as sensors in places (s, 3) show them: -1 to 1.

        Their rays are even in direction, so that as many fall on an area as its distance and its
        slope tell. How many rays each has is fitted: the most likely counts, by expectation
        maximization. Where points were thinned evenly, they tell nothing.
        """
        arms = patches.centres[self.rows, None] - places
        squares = np.maximum(np.einsum("psi,psi->ps", arms, arms), 1e-300)
        slopes = np.einsum("psi,pi->ps", arms, patches.normals[self.rows]) / np.sqrt(squares)
        # (p, s): rays per area, of each sensor.
        rays = np.maximum(np.abs(slopes), _GRAZING) / squares
        rays /= rays.mean()
        areas, density = areas_of(patches)[self.rows], np.exp(self.logs - self.logs.mean())
        counts, whole = np.full(len(places), 1.0 / len(places)), np.einsum("p,ps->s", areas, rays)
        for _ in range(_ROUNDS):
            expected = np.einsum("ps,s->p", rays, counts)
            counts *= np.einsum("p,ps->s", areas * density / expected, rays) / whole
        expected = np.einsum("ps,s->p", rays, counts)
        before, after = (
            max(_spread(logs, areas), _LEAST_SPREAD)
            for logs in (self.logs, self.logs - np.log(expected))
        )
        gain = float(np.clip(np.log(before / after), -1.0, 1.0))
        # Points that were thinned evenly tell nothing against several sensors; of one there is
        # nothing to be thinned.
        is_told = gain > 0.0 or len(places) == 1
        return gain * (1.0 if is_told else float(np.clip(before / _EVEN - 1.0, 0.0, 1.0)))


def _spread(values: FloatArray, weights: FloatArray) -> float:
    """Return what lies between two quantiles of values."""
    order = np.argsort(values)
    below = np.cumsum(weights[order]) / weights.sum()
    low, high = (values[order[np.searchsorted(below, share)]] for share in (_LOW, _HIGH))
    return float(high - low)
