"""Boxes around points."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray


def bound_points(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the low and high corner, (3,), of the box around points (n, 3): some, all finite."""
    # Column by column: numpy is slow to reduce along the first axis of narrow arrays.
    columns = positions.T
    low = np.array([column.min() for column in columns])
    return low, np.array([column.max() for column in columns])
