"""The way that a sensor came along."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray

MOST_PLACES = 64
"""Of a path: more show no more of what was measured from it."""
MOST_TIMED = 1024
"""Of one whose times are known, which is followed from place to place."""


def thin_path(places: FloatArray, most: int) -> FloatArray:
    """Return so few of the places (n, 3) of a path, or (n, 4), that all lie equally far apart."""
    if len(places) <= most:
        return places
    steps = np.linalg.norm(np.diff(places[:, :3], axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    marks = np.linspace(0.0, travelled[-1], most)
    rows = np.unique(np.searchsorted(travelled, marks).clip(max=len(places) - 1))
    return places.take(rows, axis=0)
