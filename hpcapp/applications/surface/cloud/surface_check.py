"""Points that lie on no surface are refused: such that fill a volume, and such along a line.

They are looked at twice. Thinned to a few thousand, noise is small against the spacing, and the
whole cloud fits into one look. At full density, in a few boxes, walls and folds that are finer than
the thinned spacing can be seen.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.cloud.cloud_pass import CloudPass
from hpcapp.applications.surface.cloud.measure import SAMPLED_BOX, draw_places, first_share
from hpcapp.applications.surface.scale.dimension import FEWEST, choose_counts, look_around
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import InputError

_THINNED, _MOST = 4096, 16_384  # points
_FINE = 0.25  # spacings: edge of boxes that hold a point or two
_MOST_BOXES = 2.0**19  # along an edge of the cloud
_NEAR = (FEWEST, 4 * FEWEST)  # neighbours at full density
_FEWEST_COUNTS = 3  # of neighbours: a volume of fewer points is not told from a folded surface
_VOLUME, _CURVE = 0.5, 0.75  # of the points
_FLAT = 0.15  # likewise at full density: more of them are a surface that is worth a mesh


def check_surface(cloud_pass: CloudPass, spacing: float) -> InputError | None:
    """Tell why a cloud's points lie on no surface; None where they do, or are too few to tell.

    No two points are at one place.
    """
    cloud = cloud_pass.cloud
    finest = max(_FINE * spacing, float((cloud.high - cloud.low).max()) / _MOST_BOXES)
    thinned = _draw_enough(cloud_pass, finest, -(-len(cloud) // _THINNED))
    thinned = thinned[:: -(-len(thinned) // _MOST)]  # where a box holds thousands
    counts = choose_counts(len(thinned))
    if len(counts) < _FEWEST_COUNTS - 1:
        return None
    around = look_around(thinned, counts)
    filled = 0.0 if len(counts) < _FEWEST_COUNTS else float(around.fill_volume().mean())
    if filled < _VOLUME and around.follow_curve().mean() < _CURVE:
        return None
    # What is finer than the thinned spacing, as walls and folds, is flat at full density.
    dense = _draw_enough(cloud_pass, SAMPLED_BOX * spacing, first_share(len(cloud)))[:_MOST]
    near = look_around(dense, tuple(count for count in _NEAR if count <= len(dense) // 4))
    if near.lie_flat().mean() > _FLAT:
        return None
    return _on_a_line() if filled < _VOLUME else _in_a_volume(filled, around.growth())


def _draw_enough(cloud_pass: CloudPass, edge: float, one_in: int) -> FloatArray:
    """Return the points in a sample of boxes: a quarter of `_THINNED` or more, if there are."""
    while True:
        places = draw_places(cloud_pass, edge, one_in)
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
