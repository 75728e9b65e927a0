"""How far the cells of a dense lattice are from those that are occupied."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray

__all__ = ["measure_distances"]


def measure_distances(occupied: BoolArray, threads: int = 1) -> FloatArray:
    """Measure how far each cell (x, y, z) is from the nearest one that is occupied, in cells.

    From middle to middle; infinite where none is occupied. See Felzenszwalb and Huttenlocher
    (2012), Distance transforms of sampled functions.
    """
    from scipy import ndimage  # a heavy module: the native build does without it

    del threads
    if not occupied.any():
        return np.full(occupied.shape, np.inf)
    distances: FloatArray = ndimage.distance_transform_edt(~occupied)
    return distances
