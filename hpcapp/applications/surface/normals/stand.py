"""Where a sensor stood, told by how its points lie.

A scanner that turns takes as many points in every direction. So their density falls with the square
of the distance, and nothing but a scan from a place inside looks even from a place inside. A camera
takes them in rows and columns: from where it was, and from nowhere else, they lie on a lattice.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.normals.evidence import areas_of
from hpcapp.applications.surface.normals.patches import CELL, Patches, quarter_patches
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass

_SAMPLE = 3000  # patches, about
_PLACES = 7  # along each side of the box
_BANDS = 12  # of directions, each of twice as many of equal solid angle
_NEAREST = 8  # patches whose points make the density of one
_FARTHEST = 64.0  # cells: patches beyond are none of them
_LOW, _HIGH = 0.15, 0.85  # quantiles that a spread lies between
_EVEN = 0.66  # of the spread on the surface: that from a place where a tripod stood
_AROUND = 0.94  # share of the directions in which it saw something
_PIXELS = 4000  # points whose columns and rows are looked at
_FEWEST_PIXELS = 100
_COLUMNS = 48, 2048  # of an image
_BINS = 8192  # across it
_SHARP = 0.5
"""Strength of the columns of an image, as a Fourier coefficient: of depth images, rounded to whole
millimetres or not, .98 and more; of scattered points .06 at most."""
_IN_SPACE = 0.9
"""By it, that of such columns in space: of a depth image where most is one wall .78, of rasters of
heights 1 to 3.3."""
_WIDEST = 4.0  # width of an image by its distance
_GRAZING = 0.1  # cosine: flatter slopes are known too roughly
_LEAST_SPREAD = 0.05  # of densities that were counted
_UNEVEN = 1.3  # spread on the surface, as logarithm, from which on this tells


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """How densely points lie around some patches.

    Parameters
    ----------
    rows : ndarray of int64, shape (s,)
        These patches, of all.
    logs : ndarray of float64, shape (s,)
        Logarithms of the points per area, up to a constant.
    """

    rows: IntArray
    logs: FloatArray

    @classmethod
    def of(cls, patches: Patches, spacing: float) -> Density:
        """Measure it; `spacing` is that of the cloud, in length units of the input."""
        counts = patches.counts.astype(np.float64)
        rows, edge = np.arange(0, len(patches), -(-len(patches) // _SAMPLE)), CELL * spacing
        corner = lay_lattice(patches.centres.min(axis=0), edge)
        boxes = kernels.sort_points(patches.centres, corner, edge)
        # (s, 8): of each of them the nearest ones, and the squares of their distances.
        nearest = min(_NEAREST, len(patches) - 1)
        squares, near = kernels.find_nearest(
            patches.centres, *boxes, edge, rows, nearest, _FARTHEST * edge
        )
        # (s,): what lies within a distance by the square of that.
        held = counts[rows] + np.append(counts, 0.0)[near].sum(axis=1)
        squares = np.clip(squares[:, -1], 1e-300, (_FARTHEST * edge) ** 2)
        return cls(rows, np.log(held / squares))

    def favour(self, patches: Patches, place: FloatArray) -> float:
        """Return how much more evenly points lie as a sensor in a place shows them: -1 to 1.

        Its rays are even in direction, so that as many fall on an area as its distance and its
        slope tell.
        """
        arms = patches.centres[self.rows] - place
        squares = np.maximum(np.einsum("ij,ij->i", arms, arms), 1e-300)
        slopes = np.abs(np.einsum("ij,ij->i", arms, patches.normals[self.rows])) / np.sqrt(squares)
        expected = np.log(np.maximum(slopes, _GRAZING) / squares)
        areas = areas_of(patches)[self.rows]
        before, after = (
            max(_spread(logs, areas), _LEAST_SPREAD) for logs in (self.logs, self.logs - expected)
        )
        return float(np.clip(np.log(before / after), -1.0, 1.0))


def has_stand(patches: Patches, spacing: float, density: Density) -> bool:
    """Tell whether a scanner stood in some place inside the box of a cloud, and saw all around.

    Parameters
    ----------
    patches : Patches
        Of a whole cloud.
    spacing : float
        Of the cloud, in length units of the input.
    density : Density
        Of the patches.

    Notes
    -----
    The spread of a density is the logarithm of its .85 by its .15 quantile. For 343 places it is
    taken of the points per solid angle, and once of the points per area.
    """
    if len(patches) <= _NEAREST:  # which are in too few directions from anywhere
        return False
    every, sampled = density.rows, patches.counts[density.rows].astype(np.float64)
    # Quantiles over the points, of which some patches have many more than others.
    uneven = _spread(density.logs, sampled)
    if uneven < _UNEVEN:
        return False
    # (4 s, 3): quarters of the patches, as a near patch spans several directions.
    parts = quarter_patches(patches.take(every), 0.25 * CELL * spacing)
    shares, cells = np.tile(0.25 * sampled, 4), 2 * _BANDS * _BANDS
    for place in _fill_box(patches.centres.min(axis=0), patches.centres.max(axis=0)):
        check_cancelled()
        # (288,): points in each direction; all have one solid angle.
        points = np.bincount(_find_directions(parts - place), shares, cells)
        seen = points[points > 0.0]
        if len(seen) < _AROUND * cells:
            continue
        # From where a scanner turned they are spread more evenly than over the surface.
        fewest, most = np.quantile(seen, (_LOW, _HIGH))
        if np.log(most / fewest) < _EVEN * uneven:
            return True
    return False


def _spread(values: FloatArray, weights: FloatArray) -> float:
    """Return what lies between two quantiles of values."""
    order = np.argsort(values)
    below = np.cumsum(weights[order]) / weights.sum()
    low, high = (values[order[np.searchsorted(below, share)]] for share in (_LOW, _HIGH))
    return float(high - low)


def has_pixels(positions: FloatArray) -> bool:
    """Tell whether points are the pixels of a camera at (0, 0, 0).

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)

    Notes
    -----
    Along the axis that most points lie at, y / x and z / x lie on a lattice: on columns and rows.
    Where y and z themselves do so as much, points lie on a lattice in space.
    """
    if len(positions) < _FEWEST_PIXELS:
        return False
    some = positions[:: -(-len(positions) // _PIXELS)]
    axis = int(np.argmax(np.abs(some.mean(axis=0))))
    depth = some[:, [axis]]
    if depth.min() <= 0.0 <= depth.max():
        return False
    across = np.delete(some, axis, axis=1)
    image = across / depth
    if np.ptp(image, axis=0).max() > _WIDEST:
        return False
    return all(map(_are_columns, image.T, across.T))


def _are_columns(image: FloatArray, across: FloatArray) -> bool:
    """Tell whether coordinates are those of columns in an image, and not in space."""
    few, most = _COLUMNS
    strengths = _find_strengths(image)
    # The strongest frequency: so many columns the image has. In space, a lattice with half to twice
    # as many would explain it as well.
    columns = few + int(np.argmax(strengths[few:most]))
    in_space = _find_strengths(across)[columns // 2 : 2 * columns]
    sharp = strengths[columns]
    return bool(sharp > _SHARP and in_space.max() < _IN_SPACE * sharp)


def _find_strengths(places: FloatArray) -> FloatArray:
    """Return how far coordinates take so many even steps from end to end: 0 to 1, by number."""
    width = max(float(np.ptp(places)), np.finfo(np.float64).tiny)
    # (n,): even steps from end to end are a peak in the spectrum of the histogram.
    bins = np.minimum((places - places.min()) / width * _BINS, _BINS - 1.0).astype(np.int64)
    strengths: FloatArray = np.abs(np.fft.rfft(np.bincount(bins, minlength=_BINS))) / len(places)
    return strengths


def _fill_box(low: FloatArray, high: FloatArray) -> FloatArray:
    shares = np.arange(1, _PLACES + 1) / (_PLACES + 1)
    grid = np.stack(np.meshgrid(shares, shares, shares, indexing="ij"), axis=-1).reshape(-1, 3)
    places: FloatArray = low + grid * (high - low)
    return places


def _find_directions(arms: FloatArray) -> IntArray:
    """Return for each arm the number of the direction that it points in."""
    lengths = np.maximum(np.sqrt(np.einsum("ij,ij->i", arms, arms)), 1e-300)
    # Bands of equal height on a sphere have equal areas.
    rows = np.floor((arms[:, 2] / lengths + 1.0) * (0.5 * _BANDS)).astype(np.int64)
    turns = np.arctan2(arms[:, 1], arms[:, 0]) / (2.0 * np.pi) + 0.5
    columns = np.floor(turns * 2 * _BANDS).astype(np.int64)
    numbers: IntArray = np.minimum(rows, _BANDS - 1) * 2 * _BANDS + np.minimum(
        columns, 2 * _BANDS - 1
    )
    return numbers
