"""Boxes around points."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray


def bound_points(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around some points.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        At least one point; finite.

    Returns
    -------
    low, high : ndarray of float64, shape (3,)
    """
    # Column by column: numpy is slow to reduce along the first axis of narrow arrays.
    columns = positions.T
    low = np.array([column.min() for column in columns])
    return low, np.array([column.max() for column in columns])
