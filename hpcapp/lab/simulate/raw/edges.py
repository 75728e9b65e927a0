"""Edges that a beam meets by half: there scanners measure places in the air behind them."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.lab.simulate.implicit import ImplicitShape
from hpcapp.lab.simulate.rays import cross_rays, frame_about, unit_vectors
from hpccomponent.dataclass import dataclass

_NEIGHBOURHOOD = 1.0  # units about a hit in which its edge is looked for
_WIDEST = 0.1  # radians from the pulse
_HALVINGS = 8
_MISS = 0.02  # units by which what flies misses its edge at most
_STEP = 0.03  # units between the surfaces at an edge


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Rays and what they meet.

    Rows (n,) are of the rays that were asked about; origins and directions are (n, 3), distances
    (n,) to the surface, infinite where there is none.
    """

    rows: IntArray
    origins: FloatArray
    directions: FloatArray
    distances: FloatArray

    def take(self, rows: IntArray) -> Sights:
        """Return some of them."""
        return Sights(*(getattr(self, field.name)[rows] for field in fields(self)))

    def choose(self, others: Sights, is_other: BoolArray) -> Sights:
        """Return these, and `others` where asked to: one for each."""
        return Sights(
            self.rows,
            self.origins,
            np.where(is_other[:, None], others.directions, self.directions),
            np.where(is_other, others.distances, self.distances),
        )


def find_edges(
    surface: ImplicitShape, unit: float, near: Sights, border: float, rng: np.random.Generator
) -> tuple[Sights, FloatArray]:
    """Look near hits for edges with something behind them.

    Return the rays that just miss an edge, with the distances of its near side, and the gaps: how
    much farther a ray beside each goes, infinite where it meets nothing. The border is the width of
    the strip along the sides of the bounds in which the surface just ends: what is there is no
    edge. `unit` is that of the scene.

    A second ray is drawn near the first one. Where it goes on to something else, the edge lies
    between the two and is found by halving the angle. A grazed plane is no edge: what is behind
    must be off the plane of the near side.
    """
    ahead = near.directions
    side, up = frame_about(ahead)
    turn = 2.0 * np.pi * rng.random(len(ahead))
    away = np.minimum(_WIDEST, _NEIGHBOURHOOD * unit / near.distances) * rng.random(len(ahead))
    aside = (away * np.cos(turn))[:, None] * side + (away * np.sin(turn))[:, None] * up
    far = _look(surface, near, unit_vectors(ahead + aside))
    rows = np.flatnonzero(_is_behind(surface, unit, near, far))
    near, far = near.take(rows), far.take(rows)
    outward = unit_vectors(far.directions - near.directions)
    for _ in range(_HALVINGS):
        middle = _look(surface, near, unit_vectors(near.directions + far.directions))
        is_behind = _is_behind(surface, unit, near, middle)
        near, far = near.choose(middle, ~is_behind), far.choose(middle, is_behind)
    hits = near.origins + near.distances[:, None] * near.directions
    low, high = (bound[:2] for bound in surface.bounds)
    is_inside = ((hits[:, :2] >= low + border) & (hits[:, :2] <= high - border)).all(axis=1)
    # (f, 3): beside the edge, where what flies is in the air
    beside = (_MISS * unit * rng.random(len(rows)) / near.distances)[:, None] * outward
    edges = replace(near, directions=unit_vectors(near.directions + beside))
    # what was smooth between the two has no step left
    kept = np.flatnonzero(_is_behind(surface, unit, near, far) & (is_inside | (border == 0.0)))
    return edges.take(kept), (far.distances - near.distances)[kept]


def _look(surface: ImplicitShape, sights: Sights, directions: FloatArray) -> Sights:
    """Return what is met in other directions from the same places."""
    distances = np.full(len(directions), np.inf)
    low, high = surface.bounds
    reach = float(np.linalg.norm(high - low)) + sights.distances.max(initial=0.0)
    met, distance = cross_rays(surface, sights.origins, directions, reach, first_only=True)
    distances[met] = distance
    return Sights(sights.rows, sights.origins, directions, distances)


def _is_behind(surface: ImplicitShape, unit: float, near: Sights, far: Sights) -> BoolArray:
    """Tell where `far` goes on to something else than `near`, farther away."""
    is_behind: BoolArray = np.isinf(far.distances)
    met = np.flatnonzero(~is_behind)
    first, second = (
        each.origins[met] + each.distances[met, None] * each.directions[met] for each in (near, far)
    )
    off = np.abs(np.einsum("ij,ij->i", second - first, surface.normal(first)))
    gap = far.distances[met] - near.distances[met]
    is_behind[met] = (off > _STEP * unit) & (gap > _STEP * unit)
    return is_behind
