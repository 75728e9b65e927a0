"""Points that lie on no surface are refused: such that fill a volume, and such along a line.

They are looked at twice. Thinned to a few thousand, noise is small against the spacing, and the
whole cloud fits into one look. At full density, in a few boxes, walls and folds that are finer than
the thinned spacing can be seen.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hpcapp.applications.surface.cloud.measured import SAMPLED_BOX, first_share
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.scale.dimension import FEWEST, choose_counts, look_around
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import (
    are_sampled,
    cells_of,
    lay_lattice,
    pack_places,
    shuffle_keys,
)
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import InputError

Draw = Callable[[float, int], FloatArray]
"""Given the edge of boxes and how many of them make one sampled, returns the points in the sample,
in the cloud's order."""

_THINNED, _MOST = 4096, 16_384  # points
_FINE = 0.25  # spacings: edge of boxes that hold a point or two
_MOST_BOXES = 2.0**19  # along an edge of the cloud
_NEAR = (FEWEST, 4 * FEWEST)  # neighbours at full density
_FEWEST_COUNTS = 3  # of neighbours: a volume of fewer points is not told from a folded surface
_VOLUME, _CURVE = 0.5, 0.75  # of the points
_FLAT = 0.15  # likewise at full density: more of them are a surface that is worth a mesh


def find_no_surface(
    draw: Draw, points: int, low: FloatArray, high: FloatArray, spacing: float
) -> InputError | None:
    """Tell why a cloud's points lie on no surface; None where they do, or are too few to tell.

    Parameters
    ----------
    draw : callable
        See `Draw`. No two points are at one place.
    points : int
        Of the cloud.
    low, high : ndarray of float64, shape (3,)
        Corners of the box around all points.
    spacing : float
        In length units of the input.
    """
    finest = max(_FINE * spacing, float((high - low).max()) / _MOST_BOXES)
    thinned = _draw_enough(draw, finest, -(-points // _THINNED))
    thinned = thinned[:: -(-len(thinned) // _MOST)]  # where a box holds thousands
    counts = choose_counts(len(thinned))
    if len(counts) < _FEWEST_COUNTS - 1:
        return None
    around = look_around(thinned, counts)
    filled = 0.0 if len(counts) < _FEWEST_COUNTS else float(around.fill_volume().mean())
    if filled < _VOLUME and around.follow_curve().mean() < _CURVE:
        return None
    # What is finer than the thinned spacing, as walls and folds, is flat at full density.
    dense = _draw_enough(draw, SAMPLED_BOX * spacing, first_share(points))[:_MOST]
    near = look_around(dense, tuple(count for count in _NEAR if count <= len(dense) // 4))
    if near.lie_flat().mean() > _FLAT:
        return None
    return _on_a_line() if filled < _VOLUME else _in_a_volume(filled, around.growth())


def find_no_surface_in(positions: FloatArray) -> InputError | None:
    """Tell why points in memory lie on no surface; see `find_no_surface`.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input, no two at one place.

    Raises
    ------
    InputError
        All points are the same.
    """
    low, high = bound_points(positions)

    def draw(edge: float, one_in: int) -> FloatArray:
        return sample_positions(positions, lay_lattice(low, edge), edge, one_in)

    return find_no_surface(draw, len(positions), low, high, estimate_spacing(positions))


def sample_positions(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> FloatArray:
    """Return the points in a sample of boxes, in their order.

    Unlike those of `kernels.sample_boxes` the boxes make no pattern, whichever the points make.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
    low : ndarray of float64, shape (3,)
        Corner of a box.
    edge : float
        Of a box, in length units of the input.
    one_in : int
        About one box in so many is in the sample.
    """
    places = np.floor(cells_of(positions, low, edge)).astype(np.int64)
    return positions[are_sampled(shuffle_keys(pack_places(places)), one_in)]


def _draw_enough(draw: Draw, edge: float, one_in: int) -> FloatArray:
    """Return the points in a sample of boxes: a quarter of `_THINNED` or more, if there are."""
    while True:
        places = draw(edge, one_in)
        if len(places) >= _THINNED // 4 or one_in == 1:
            return places
        one_in = max(one_in // 8, 1)


def _in_a_volume(filled: float, growth: FloatArray) -> InputError:
    return InputError(
        f"the points fill a volume: around {filled:.0%} of them there are points in all directions,"
        f" whose number grows with power {np.median(growth):.1f} of the distance, on a surface "
        "with 2",
        "hpcapp makes surfaces of points that lie on them: keep the outermost points alone, or "
        "take the isosurface of a density (particles, voxels, CT)",
    )


def _on_a_line() -> InputError:
    return InputError(
        "the points lie on a line: their neighbours spread along one direction at all distances",
        "a surface needs points beside each other: check that x, y and z are the right columns and "
        "have one unit (degrees beside metres look so: project the points first)",
    )
