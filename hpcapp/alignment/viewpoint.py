"""Where a scan was taken from, and through which space it has looked.

Along the ray to each of its points a scanner has seen that nothing is there. Points of another
scan that lie there after it was moved speak against the move.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from hpcapp.alignment.sample import FEWEST, Cells, Sample, sample_scan
from hpcapp.geometry.points import BoolArray, FloatArray
from hpccomponent.dataclass import dataclass

_DRAWN = 1500
_NEIGHBOUR = 8  # the one whose distance tells how dense points are
_QUANTILES = (0.15, 0.85)
_EVENER = 0.08
"""How much more even (log of the quantiles' ratio) points must be seen from a viewpoint than on the
surface before it is believed, and by half of it more than from its opposite: 24 objects from a side
.06 to .48, tripods .3 to 1.1; where there is none (flights, random samples) up to .04."""
_EDGE, _LEAST_EDGE = 60, 2.0  # cells of the diagonal, and spacings: to ask what hides what
_MOST_HIDDEN, _BEHIND = 0.02, 2.0  # of the cells, by so many edges: no viewpoint sees more behind
_FAR = (1.5, 10.0)  # extents: how far a camera outside is thought to be
_SIDES = 120
_NEAR_ORIGIN = 20.0  # extents: farther away the origin of coordinates is no scanner
_FINER = (0.12, 0.04)  # radians
_NEXT = 3  # of a view's points that must all lie beyond
_GAP = 1.5  # of the distance of a view's points, up to which it has looked between them
_GRAZING = 0.25  # cosine


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Cells as they are seen from an eye."""

    cells: Cells
    eye: FloatArray
    ranges: FloatArray
    gaps: FloatArray  # angles, (n,)
    directions: KDTree

    @classmethod
    def of(cls, cells: Cells, eye: FloatArray) -> View:
        """Look at cells from an eye, shape (3,)."""
        ranges, rays = _split(cells.positions - eye)
        tree = KDTree(rays)
        return cls(cells, eye, ranges, tree.query(rays, _NEXT + 1)[0][:, _NEXT], tree)

    def compare(self, positions: FloatArray) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Return whether the view covers each position, and how much farther and nearer it ends.

        Both in edges of a cell: how far the nearest of the surfaces seen about the ray lies beyond
        the position, and how far the farthest lies before it.
        """
        ranges, rays = _split(positions - self.eye)
        angles, seen = self.directions.query(rays, _NEXT)
        covered = angles[:, -1] < _GAP * self.gaps[seen[:, 0]]
        # Where the ray meets the plane of each of those seen, (n, 3).
        normals = self.cells.normals[seen]
        along = np.einsum("nki,ni->nk", normals, rays)
        heights = np.einsum("nki,nki->nk", normals, self.cells.positions[seen] - self.eye)
        steep = np.abs(along) > _GRAZING
        own = self.ranges[seen]
        met = np.where(steep, heights / np.where(steep, along, 1.0), own)
        slack = 4 * self.cells.edge
        beyond = np.minimum(met, own + slack).min(axis=1) - ranges
        before = ranges - np.maximum(met, own - slack).max(axis=1)
        return covered, beyond / self.cells.edge, before / self.cells.edge


def see_scan(positions: FloatArray, scanner: FloatArray | None = None) -> Sample:
    """Sample a scan, (n, 3), and tell where it was taken from; `scanner`, (3,), is known to."""
    sample = sample_scan(positions)
    sample.eye = find_eye(sample) if scanner is None else scanner - sample.centre
    return sample


def find_eye(sample: Sample) -> FloatArray | None:
    """Return where a scan was taken from, about its centre; None where its points do not tell it.

    A scanner's directions are even; points that it has measured are so as it sees them, not as
    they lie on the surface. Tried: the origin of coordinates, and places all around outside.
    """
    points = sample.positions[np.random.default_rng(0).permutation(len(sample.positions))[:_DRAWN]]
    on_surface = _unevenness(points)

    def rate(eye: FloatArray) -> float:
        ranges, rays = _split(points - eye)
        return _unevenness(rays) - on_surface if ranges.min() > 0 else np.inf

    def look(side: FloatArray) -> tuple[float, FloatArray]:
        eyes = [far * sample.extent * side for far in _FAR]
        return min(((rate(eye), eye) for eye in eyes), key=lambda rated: rated[0])

    rating, eye = min(map(look, _spread_sides(_SIDES)), key=lambda rated: rated[0])
    rng = np.random.default_rng(1)
    for width in _FINER:
        turned = _split(eye / np.linalg.norm(eye) + width * rng.normal(size=(30, 3)))[1]
        rating, eye = min([(rating, eye), *map(look, turned)], key=lambda rated: rated[0])
    # From very far the picture is as even from behind.
    if look(-eye / np.linalg.norm(eye))[0] < rating + _EVENER / 2:
        rating = np.inf
    if np.linalg.norm(sample.centre) < _NEAR_ORIGIN * sample.extent:
        at_origin = rate(-sample.centre)
        if at_origin <= rating:
            rating, eye = at_origin, -sample.centre
    if rating > -_EVENER:
        return None
    cells = sample.at(max(sample.extent / _EDGE, _LEAST_EDGE * sample.spacing))
    if len(cells.positions) < FEWEST:
        return None
    covered, _, before = View.of(cells, eye).compare(cells.positions)
    hidden = (before[covered] > _BEHIND).mean() if covered.any() else 1.0
    return eye if hidden < _MOST_HIDDEN else None


def _unevenness(points: FloatArray) -> float:
    """Return how much distances between neighbours differ, as the logarithm of a ratio."""
    distances = KDTree(points).query(points, _NEIGHBOUR + 1)[0][:, _NEIGHBOUR]
    low, high = np.quantile(distances, _QUANTILES)
    return float(np.log(high / max(low, 1e-300)))


def _split(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lengths, (n,), and directions, (n, 3)."""
    lengths = np.linalg.norm(vectors, axis=1)
    return lengths, vectors / np.maximum(lengths, 1e-300)[:, None]


def _spread_sides(count: int) -> FloatArray:
    """Return unit vectors all around, (count, 3), on a Fibonacci lattice."""
    at = np.arange(count) + 0.5
    z, angle = 1 - 2 * at / count, np.pi * (1 + np.sqrt(5)) * at
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
